"""Random calls of FMUs of the pythonfmu flavour, in a process of their own."""

#: For `fresh`: A.fmu, A.calls and A.seed; reports the number of calls by status. The phases are those of FMI 2.0.5,
#: section 4.2.4; pythonfmu's binary has fmi2Fatal for what is an error.
SCRIPT = """
import collections, math, random
rng = random.Random(A.seed)
host = Host(A.fmu)
names, statuses, kept = list(host.vr), collections.Counter(), []
phase, time = "instantiated", 0.0
numbers = [0.0, 0.25, -0.5, 1.0, 2.0, -3.0, 1e-3, 30.0, 1e3, 1e300, math.nan, math.inf]
ALLOWED = {
    "SetupExperiment": "instantiated set_up", "EnterInitializationMode": "set_up",
    "ExitInitializationMode": "initialising",
    "Terminate": "stepping discarded", "GetReal": "initialising stepping discarded terminated failed",
    "SetReal": "instantiated set_up initialising stepping", "DoStep": "stepping",
    "Reset": "", "save": "", "restore": "",
}

def references():
    chosen = rng.choices(names, k=rng.randrange(5)) if rng.random() < 0.97 else [len(names) + 3]
    return chosen, host._references(chosen)

while sum(statuses.values()) < A.calls:
    call = rng.choice(list(ALLOWED))
    if phase in ("discarded", "terminated", "failed") and rng.random() < 0.5:
        call = "restore" if kept else "Reset"
    if call in ("Reset", "Terminate") and rng.random() < 0.8 and phase == "stepping":
        continue
    length, values, begin = rng.choice([1e-3, 1e-2, 1e-3, 1e-2, 0.0, -1.0, math.nan]), None, time
    if call == "SetupExperiment":
        start, has_stop = rng.choice([0.0, 0.5, 0.0, math.nan]), rng.random() < 0.3
        status = host.call(call, 0, 0.0, start, has_stop, start + 0.02)
        if status == 0:
            time = start
    elif call in ("GetReal", "SetReal"):
        chosen, vr = references()
        values = (ctypes.c_double * 6)(*(rng.choice(numbers) for _ in range(6)))
        status = host.call(call, vr, len(chosen), values)
    elif call == "DoStep":
        begin = time + (0.3 if rng.random() < 0.03 else 0.0)
        status = host.call(call, begin, length, 1)
    elif call == "save":
        state = ctypes.c_void_p()
        status = host.call("GetFMUstate", ctypes.byref(state))
        kept.append((state, phase, time))
        if len(kept) > 4:
            host.drop(kept.pop(rng.randrange(4))[0])
    elif call == "restore":
        if not kept:
            continue
        state, *before = rng.choice(kept)
        status = host.call("SetFMUstate", state)
    else:
        status = host.call(call)
    said = host.said()
    statuses[status] += 1
    forbidden = ALLOWED[call] and phase not in ALLOWED[call].split()
    assert status in (0, 2, 4), (call, phase, status, said)
    assert not forbidden or status == 4, (call, phase, status)
    assert status == 0 or said, (call, phase, status)
    if status == 4:
        phase = "failed"
    elif call == "DoStep":
        assert status == 2 or (begin == time and length > 0.0), (begin, time, length)
        phase, time = ("discarded", time) if status else (phase, time + length)
    elif call == "restore":
        phase, time = before
    else:
        assert status == 0, (call, phase, status, said)
        phase = {"SetupExperiment": "set_up", "EnterInitializationMode": "initialising",
                 "ExitInitializationMode": "stepping",
                 "Terminate": "terminated", "Reset": "instantiated"}.get(call, phase)
        if call == "Reset":
            time = 0.0
        if call == "GetReal":
            for name, value in zip(chosen, values):
                assert math.isfinite(value) or host.causality[name] != "output", (name, value)
report(statuses)
"""
