"""What a page says of runs besides their curves: state, events, numbers, parameters, and how they were made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from typing import TYPE_CHECKING, Any

from cosim.fmi.messages import notes
from cosim.page.document import table

if TYPE_CHECKING:
    from cosim.results.recorded import Recorded

#: So many events are drawn and listed.
_MOST_EVENTS = 200

#: Of the log, so many lines are in the page, half from its beginning and half from its end.
_MOST_LINES = 1000


def number(value: Any) -> str:
    """A value as text: numbers with six digits and a real minus sign."""
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "–"}[value]
    if isinstance(value, int):
        return str(value).replace("-", "−")
    return f"{value:.6g}".replace("-", "−") if isinstance(value, float) else str(value)


def moment(time: float) -> str:
    """A time (s) as text, also far from zero."""
    return f"{time:.12g}".replace("-", "−")


def flattened(entries: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested mappings as one, with names joined by points; lists as texts."""
    found: dict[str, Any] = {}
    for name, value in entries.items():
        if isinstance(value, Mapping):
            found |= flattened(value, f"{before}{name}.")
        else:
            found[before + name] = ", ".join(map(str, value)) if isinstance(value, list | tuple) else value
    return found


def start_values(info: Mapping[str, Any]) -> dict[str, Any]:
    """Real parameters as the FMUs had them, and all else that was set for the run, by name."""
    return {**info.get("parameters", {}), **info.get("start_values", {})}


def title_of(info: Mapping[str, Any], otherwise: str) -> str:
    """The title of a run."""
    return str(info.get("title") or info.get("scenario") or otherwise)


def status_badge(info: Mapping[str, Any]) -> str:
    """How a run ended, as HTML; nothing where nobody says."""
    status = str(info.get("status", ""))
    if not status:
        return ""
    look, icon = {"completed": ("good", "✓"), "failed": ("bad", "✗")}.get(status, ("part", "◐"))
    return f'<span class="badge {look}"><span aria-hidden="true">{icon}</span> {escape(status)}</span>'


def in_a_line(run: Recorded) -> str:
    """Duration, step, order and size of a run, as HTML."""
    info, n = run.info, len(run.time)
    parts = []
    if n:
        parts.append(f"{moment(run.time[0])} to {moment(run.time[-1])} s")
    if "step_size" in info:
        step = info["step_size"]
        parts.append(f"{step} communication steps" if isinstance(step, str) else f"communication step {step:g} s")
    if "order" in info:
        parts.append(f"{escape(str(info['order']))} order")
    if fmus := info.get("fmus"):
        parts.append(f"{len(fmus)} FMU{'s' * (len(fmus) != 1)}")
    parts.append(f"{n:,} row{'s' * (n != 1)} of {len(run.names):,} value{'s' * (len(run.names) != 1)}")
    return ", ".join(parts)


def events(run: Recorded) -> list[dict[str, Any]]:
    """What happened when: `time` (s), `text`, and `kind`, which is input, message or end."""
    info = run.info
    found: list[tuple[float, str, str]] = []
    shapes = {**info.get("signals", {}), **info.get("disturbances", {})}
    begins = {t: s["start_time"] for t, s in shapes.items() if isinstance(s, Mapping) and s.get("start_time")}
    found += [(float(time), f"{target} sets in", "input") for target, time in begins.items()]
    for target, moments in info.get("breakpoints", {}).items():
        found += [(float(t), f"{target} jumps or bends", "input") for t in moments if t != begins.get(target)]
    for component, about in info.get("messages", {}).items():
        for kind in about.get("first", ()):
            if kind.get("time") is not None:
                found.append((float(kind["time"]), f"{component}: {kind['text']}", "message"))
    for name, mark in info.get("nonfinite", {}).items():
        found.append((float(mark["time"]), f"{name} is not finite in {mark['rows']} rows", "message"))
    for command in info.get("commands", ()):
        known = flattened({key: value for key, value in command.items() if key not in ("time", "point")})
        done = ", ".join(f"{key.removeprefix('set.')} = {number(value)}" for key, value in known.items())
        found.append((float(command["time"]), done, "input"))
    if coupling := info.get("coupling"):
        text = f"largest coupling error, in {coupling['variable']}: {number(coupling['error'])}"
        found.append((float(coupling["time"]), text, "message"))
    if ended_by := info.get("ended_by"):
        found.append((float(ended_by["time"]), f"{ended_by['component']} ended the simulation", "end"))
    if info.get("error") and len(run.time):
        found.append((float(run.time[-1]), str(info["error"]), "end"))
    inside = [e for e in found if len(run.time) and run.time[0] < e[0] <= run.time[-1]]
    return [{"time": t, "text": text, "kind": kind} for t, text, kind in sorted(inside)[:_MOST_EVENTS]]


def remarks(info: Mapping[str, Any]) -> list[str]:
    """What was out of the ordinary, as texts."""
    return list(_remarks(info))


def _remarks(info: Mapping[str, Any]) -> Iterator[str]:
    if error := info.get("error"):
        yield str(error)
    if kept := info.get("inputs_kept"):
        yield f"Nothing feeds these inputs, which keep the start values of their FMUs: {', '.join(kept)}."
    for component, n in info.get("steps_repeated", {}).items():
        yield f"{component} discarded {n} steps, which were repeated in shorter ones."
    for component, n in info.get("events_between_points", {}).items():
        yield f"{component} had {n} events between communication points."
    for component, why in info.get("derivatives_refused", {}).items():
        yield f"{component} refuses derivatives of its inputs ({why}); they are held."
    for name, why in info.get("not_recorded", {}).items():
        yield f"{name} is not recorded: {why}."
    for component in info.get("tolerance_assumed", ()):
        yield f"{component} fails without a tolerance, and was told one."
    yield from map(str, info.get("not_terminated", {}).values())
    yield from map(str, info.get("notes", ()))
    yield from notes(info.get("messages", {}))
    if pace := info.get("realtime"):
        yield (
            f"Paced at {pace['factor']:g} times real time: {pace['overruns']} overruns, late by at most "
            f"{pace['lateness_max_s'] * 1e3:.3g} ms."
        )


def happened(run: Recorded, whose: str = "the run") -> str:
    """Events and remarks as HTML; empty where there are none."""
    rows = [
        (
            f'<button type="button" class="moment" data-time="{e["time"]!r}">{escape(moment(e["time"]))} s</button>',
            escape(e["text"]),
        )
        for e in events(run)
    ]
    lines = "".join(f"<li>{escape(text)}</li>" for text in remarks(run.info))
    moments = table(("time", "event"), rows, f"Events of {whose}") if rows else ""
    return (f'<ul class="remarks">{lines}</ul>' if lines else "") + moments


def pairs(entries: Mapping[str, Any], heads: tuple[str, str], caption: str, kind: str = "") -> str:
    """A table of names and values."""
    rows = [(f"<code>{escape(name)}</code>", escape(number(value))) for name, value in entries.items()]
    return table(heads, rows, caption, kind)


def profile(info: Mapping[str, Any]) -> str:
    """Times of components and the error of the coupling, as bars, where they were measured."""
    charts = []
    if components := info.get("profile", {}).get("components"):
        times = {name: (float(c["steps_s"]), float(c["exchange_s"])) for name, c in components.items()}
        keys = '<span class="first">steps</span> <span class="second">exchange of values</span>'
        charts.append(f'<h3>Time of each component (s)</h3><p class="hint keys">{keys}</p>{_bars(times)}')
    if coupling := info.get("coupling"):
        where = f"in {coupling['variable']}, at {number(coupling['time'])} s"
        charts.append(
            f"<h3>Coupling error</h3><p>Estimated at {number(coupling['error'])} of the largest magnitude, largest "
            f"{escape(where)}; allowed are {number(coupling['tolerance'])}. Steps that were tried:</p>"
        )
        tried = {f"{number(t['step_size'])} s": (float(t["error"]), 0.0) for t in coupling["tried"] if t["error"]}
        charts.append(_bars(tried))
    return "".join(charts)


def _bars(values: Mapping[str, tuple[float, float]]) -> str:
    """A bar of two parts for each name, and the sum in numbers; the largest first."""
    largest = max((sum(pair) for pair in values.values()), default=0.0) or 1.0
    rows = []
    for name, (first, second) in sorted(values.items(), key=lambda one: -sum(one[1])):
        widths = [200.0 * part / largest for part in (first, second)]
        rows.append(
            f'<li><span>{escape(name)}</span><svg viewBox="0 0 200 12" aria-hidden="true" preserveAspectRatio="none">'
            f'<rect width="{widths[0]:.4g}" height="12"/>'
            f'<rect class="second" x="{widths[0]:.4g}" width="{widths[1]:.4g}" height="12"/></svg>'
            f"<b>{escape(number(first + second))}</b></li>"
        )
    return f'<ul class="bars">{"".join(rows)}</ul>'


def made(info: Mapping[str, Any], whose: str = "the run") -> str:
    """Settings, FMUs with their hashes, and versions; `whose` tells the tables of several runs apart."""
    settings = {
        name: info[name]
        for name in ("scenario", "ssp", "osp", "fmu", "seed", "step_size", "start_time", "stop_time", "order",
                     "record_every", "loop_time_s", "wall_time_s")
        if info.get(name) is not None
    }  # fmt: skip
    extrapolation = info.get("extrapolation")
    if isinstance(extrapolation, Mapping):
        settings["extrapolation"] = "; ".join(
            f"{name}: {len(value)} inputs" if isinstance(value, list) else f"{name} {value}"
            for name, value in extrapolation.items()
            if value
        )
    settings |= flattened({key: info[key] for key in ("model_exchange", "threads") if key in info})
    parts = []
    if settings:
        parts.append(f"<h3>Settings</h3>{pairs(settings, ('setting', 'value'), f'Settings of {whose}')}")
    if fmus := info.get("fmus"):
        rows = [
            (escape(name), f"<code>{escape(str(f.get('path', '')))}</code>", f"<code>{f.get('sha256', '')}</code>")
            for name, f in fmus.items()
        ]
        parts.append(f"<h3>FMUs</h3>{table(('component', 'file', 'SHA-256'), rows, f'FMUs of {whose}', 'hashes')}")
    if versions := info.get("versions"):
        parts.append(f"<h3>Software</h3>{pairs(versions, ('package', 'version'), f'Software of {whose}')}")
    if files := info.get("files"):
        hashes = [(f"<code>{escape(name)}</code>", f"<code>{escape(str(sha))}</code>") for name, sha in files.items()]
        parts.append(f"<h3>Files</h3>{table(('file', 'SHA-256'), hashes, f'Files of {whose}', 'hashes')}")
    return '<div class="columns">' + "\n".join(f"<div>{part}</div>" for part in parts) + "</div>" if parts else ""


def log_text(text: str) -> str:
    """The log of the FMUs as HTML, shortened in the middle."""
    lines = text.splitlines()
    if len(lines) > _MOST_LINES:
        half = _MOST_LINES // 2
        left_out = f"... {len(lines) - 2 * half} lines ..."
        lines = [*lines[:half], left_out, *lines[-half:]]
    return f'<pre class="log" tabindex="0" role="region" aria-label="Log">{escape(chr(10).join(lines))}</pre>'
