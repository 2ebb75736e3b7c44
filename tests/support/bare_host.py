"""FMUs in a new process that can't import this project: `fresh` runs a script there.

`HOST` gives that script an importer written with ctypes alone: an oracle that shares no code with fmpy or with `cosim`.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from cosim.fmi.unpacking import folder_for_fmus, is_plain
from fmu_export.modelling.functions import rk4_step
from fmu_export.modelling.model import Model
from tests.support.patience import PATIENCE

HOST = '''
import ctypes, importlib.util, json, os, sys, tempfile, zipfile
from types import SimpleNamespace
from xml.etree import ElementTree

PROJECT = ("plant_fmu", "controller_fmu", "fmu_export", "cosim", "tests")


class Blocker:
    """Import hook: these packages are not installed here, whatever the environment holds."""

    def __init__(self, names):
        self.names = names

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.names:
            raise ModuleNotFoundError(f"No module named {name!r} (blocked)")
        return None


sys.meta_path.insert(0, Blocker(PROJECT))
for name in PROJECT:
    try:
        __import__(name)
    except ModuleNotFoundError:
        continue
    raise SystemExit(f"{name} can be imported")

A = SimpleNamespace(**json.load(sys.stdin))


def report(value):
    with open("report.json", "w") as stream:
        json.dump(value, stream)


class Library:
    """The C functions of an FMU by ctypes alone; `call` returns the status of a function."""

    LOGGER = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
    ALLOCATE = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t)
    FREE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
    ARGUMENTS = {
        "SetupExperiment": "iddid", "EnterInitializationMode": "", "ExitInitializationMode": "", "Terminate": "",
        "Reset": "", "DoStep": "ddi", "GetReal": "pnp", "SetReal": "pnp", "GetInteger": "pnp", "SetInteger": "pnp",
        "GetBoolean": "pnp", "SetBoolean": "pnp", "GetString": "pnp", "SetString": "pnp", "GetFMUstate": "p",
        "SetFMUstate": "p", "FreeFMUstate": "p", "SerializedFMUstateSize": "pp", "SerializeFMUstate": "ppn",
        "DeSerializeFMUstate": "pnp", "GetRealStatus": "ip", "GetBooleanStatus": "ip",
    }
    TYPES = {"i": ctypes.c_int, "d": ctypes.c_double, "p": ctypes.c_void_p, "n": ctypes.c_size_t}

    def __init__(self, folder, identifier, guid, name, log):
        platform, suffix = ("win64", ".dll") if os.name == "nt" else ("linux64", ".so")
        self.shared_library = ctypes.CDLL(os.path.join(folder, "binaries", platform, identifier + suffix))

        class Callbacks(ctypes.Structure):
            _fields_ = [("logger", self.LOGGER), ("allocate", self.ALLOCATE), ("free", self.FREE),
                        ("finished", ctypes.c_void_p), ("environment", ctypes.c_void_p)]

        # the format comes without its arguments: this logger sees what a printf would be given
        logger = lambda environment, instance, status, category, message: log(status, category, message)
        c = ctypes.CDLL(None if os.name != "nt" else "msvcrt")
        c.calloc.restype = ctypes.c_void_p
        self.callbacks = Callbacks(
            self.LOGGER(logger),
            self.ALLOCATE(lambda n, size: c.calloc(ctypes.c_size_t(n), ctypes.c_size_t(size))),
            self.FREE(lambda p: c.free(ctypes.c_void_p(p))), None, None,
        )
        instantiate = self.shared_library.fmi2Instantiate
        instantiate.restype = ctypes.c_void_p
        uri = "file://" + ("/" if os.name == "nt" else "") + os.path.join(folder, "resources").replace(os.sep, "/")
        self.component = instantiate(
            name.encode(), 1, guid.encode(), uri.encode(), ctypes.byref(self.callbacks), 0, 1
        )
        if not self.component:
            raise RuntimeError("fmi2Instantiate returned NULL")
        self.component = ctypes.c_void_p(self.component)

    def call(self, name, *arguments):
        f = getattr(self.shared_library, "fmi2" + name)
        f.restype = ctypes.c_int
        f.argtypes = [ctypes.c_void_p, *(self.TYPES[t] for t in self.ARGUMENTS[name])]
        return f(self.component, *arguments)

    def free(self):
        self.shared_library.fmi2FreeInstance.restype = None
        self.shared_library.fmi2FreeInstance(self.component)


class Host:
    """An instance of an FMU; everything returns FMI statuses, nothing raises but a failed get."""

    def __init__(self, fmu, folder=None, library=Library, name="instance"):
        self.folder = folder or tempfile.mkdtemp(dir=".")
        self.folder = os.path.abspath(self.folder)
        if fmu is not None:
            with zipfile.ZipFile(fmu) as archive:
                archive.extractall(self.folder)
        root = ElementTree.parse(os.path.join(self.folder, "modelDescription.xml")).getroot()
        self.vr = {v.get("name"): int(v.get("valueReference")) for v in root.iter("ScalarVariable")}
        self.causality = {v.get("name"): v.get("causality") for v in root.iter("ScalarVariable")}
        self.outputs = [n for n, c in self.causality.items() if c == "output"]
        self.messages = []
        identifier = root.find("CoSimulation").get("modelIdentifier")
        self.shared_library = library(self.folder, identifier, root.get("guid"), name, self._log)
        self.call = self.shared_library.call

    def _log(self, status, category, message):
        text = message.decode()
        assert "%" not in text.replace("%%", ""), f"bare percent sign in {text!r}"
        self.messages.append(text)

    def said(self):
        """The messages since the last call, as one text."""
        text, self.messages = "\\n".join(self.messages), []
        return text

    def _references(self, names):
        return (ctypes.c_uint * len(names))(*(n if isinstance(n, int) else self.vr[n] for n in names))

    def get(self, *names):
        names = names or self.outputs
        values = (ctypes.c_double * len(names))()
        status = self.call("GetReal", self._references(names), len(names), values)
        assert status == 0, f"fmi2GetReal: status {status}, {self.said()}"
        return list(values)

    def set(self, values):
        array = (ctypes.c_double * len(values))(*values.values())
        return self.call("SetReal", self._references(list(values)), len(values), array)

    def setup(self, start=0.0):
        return self.call("SetupExperiment", 0, 0.0, start, 0, 0.0)

    def enter(self):
        return self.call("EnterInitializationMode")

    def leave(self):
        return self.call("ExitInitializationMode")

    def initialize(self, values=None, start=0.0):
        """The worst status of all calls up to the end of the initialisation."""
        statuses = [self.setup(start), self.enter()]
        if values:
            statuses.append(self.set(values))
        return max([*statuses, self.leave()])

    def step(self, t, h):
        return self.call("DoStep", t, h, 1)

    def run(self, n, h=1e-3, start=0, inputs=None):
        """Outputs after each of n steps; `inputs(t)` are set before each."""
        rows = []
        for i in range(start, start + n):
            if inputs is not None:
                assert self.set(inputs(i * h)) == 0
            assert self.step(i * h, h) == 0, self.said()
            rows.append(self.get())
        return rows

    def reset(self):
        return self.call("Reset")

    def save(self):
        state = ctypes.c_void_p()
        assert self.call("GetFMUstate", ctypes.byref(state)) == 0
        return state

    def restore(self, state):
        return self.call("SetFMUstate", state)

    def drop(self, state):
        return self.call("FreeFMUstate", ctypes.byref(state))

    def to_bytes(self, state):
        size = ctypes.c_size_t()
        assert self.call("SerializedFMUstateSize", state, ctypes.byref(size)) == 0
        data = (ctypes.c_char * size.value)()
        assert self.call("SerializeFMUstate", state, data, size) == 0
        return bytes(data)

    def from_bytes(self, data):
        state = ctypes.c_void_p()
        status = self.call("DeSerializeFMUstate", ctypes.create_string_buffer(data, len(data)), len(data),
                           ctypes.byref(state))
        return status, state

    def free(self):
        self.shared_library.free()


def torques(t):
    """Some smooth input of the plant."""
    from math import cos, sin
    return {"tau_a[1]": 0.2 * sin(3 * t), "tau_a[2]": -0.1 * cos(2 * t), "tau_d[3]": 0.05, "dm": 0.1 * sin(t)}


def measurements(t):
    """Some smooth input of the controller."""
    from math import cos, sin
    return {"theta_a[1]": 0.3 * sin(3 * t), "omega_a[1]": 0.9 * cos(3 * t), "theta_ref[2]": 0.2, "omega_ref[3]": -t}
'''


def fresh(root: Path, script: str, /, **arguments):
    """Run a script behind `HOST` in a new process, in an empty folder, and return what it reported.

    The process must end by itself with exit code 0: a crash at the exit of the interpreter counts as well. The folder
    is below `root`, or elsewhere where the path has what a URI escapes: other hosts can't run pythonfmu FMUs there.
    """
    if not is_plain(root):
        with folder_for_fmus() as elsewhere:
            return fresh(Path(elsewhere), script, **arguments)
    work = root / f"process_{len(list(root.glob('process_*')))}"
    work.mkdir(parents=True)
    environment = {**os.environ, "TMPDIR": str(work)}
    command = [sys.executable, "-I", "-X", "faulthandler", "-c", HOST + script]
    texts = {k: str(v) if isinstance(v, Path) else v for k, v in arguments.items()}
    process = subprocess.run(
        command,
        input=json.dumps(texts),
        cwd=work,
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    said = f"exit code {process.returncode}\n{process.stdout[-2000:]}\n{process.stderr[-4000:]}"
    assert process.returncode == 0, said
    assert "Exception ignored" not in process.stderr, said  # raised in a callback or a destructor
    written = work / "report.json"
    return json.loads(written.read_text()) if written.exists() else None


def plant_torques(t: float) -> dict[str, float]:
    return {
        "tau_a[1]": 0.2 * np.sin(3 * t),
        "tau_a[2]": -0.1 * np.cos(2 * t),
        "tau_d[3]": 0.05,
        "dm": 0.1 * np.sin(t),
    }


def oracle(model: Model, n: int, inputs=None, h: float = 1e-3, **parameters: float) -> np.ndarray:
    """Outputs after each of n steps by the model's own numpy functions."""
    p = model.parameters.starts.copy()
    for name, value in parameters.items():
        p[model.parameters.names.index(name)] = value
    x, rows = model.initial_state(p), []
    for i in range(n):
        u = model.inputs.starts.copy()
        for name, value in (inputs(i * h) if inputs else {}).items():
            u[model.inputs.names.index(name)] = value
        x = rk4_step(model.derivatives, i * h, x, u, p, h) if len(x) else x
        rows.append(model.output_values(i * h + h, x, u, p))
    return np.array(rows)


def close(rows, expected):
    np.testing.assert_allclose(np.array(rows), expected, rtol=1e-10, atol=1e-12)
