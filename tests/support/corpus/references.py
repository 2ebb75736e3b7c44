"""Reference cases of an FMU that are broken, hostile, or unclean: inputs, references, options, tolerances."""

from __future__ import annotations

from pathlib import Path

from tests.support.corpus.case import REFUSED, RUNS, Case, Materials, fmu_2

_REFERENCE = "time,y\n0,0\n0.5,0\n1,0\n"
_OPTIONS = "StartTime, 0\nStopTime, 1\nStepSize, 0.1\nRelTol, 0.001\n"


def _case(name: str, says: str = "", expected: str = REFUSED, **files: str | bytes | None) -> Case:
    """A case of the FMU; files are named `ref_csv`, `in_csv`, `ref_opt`, `ref_toml` and others with an ending."""

    def make(folder: Path, materials: Materials) -> Path:
        path = fmu_2(folder, materials)
        for file, content in ({"ref_csv": _REFERENCE, "ref_opt": _OPTIONS} | files).items():
            stem, _, ending = file.rpartition("_")
            if content is not None:
                data = content.encode() if isinstance(content, str) else content
                (folder / f"x_{stem}.{ending}").write_bytes(data)
        return path

    return Case(f"reference: {name}", make, expected, says, "reference")


REFERENCES: tuple[Case, ...] = (
    _case("as it is", expected=RUNS),
    _case("none", "reference", ref_csv=None),
    _case("that is empty", "x_ref.csv", ref_csv=""),
    _case("of zeros", "x_ref.csv", ref_csv=bytes(1000)),
    _case("that is a text", "x_ref.csv", ref_csv="hello\n"),
    _case("of a header only", "", ref_csv="time,y\n"),
    _case("without a time", "x_ref.csv", ref_csv="y\n0\n1\n"),
    _case("of one column", "", ref_csv="time\n0\n1\n"),
    _case("of rows that differ", "x_ref.csv", ref_csv="time,y\n0,0\n1\n"),
    _case("of texts", "is text in the reference", ref_csv="time,y\n0,zero\n1,one\n"),
    _case("of times that descend", "x_ref.csv", ref_csv="time,y\n1,1\n0,0\n"),
    _case("of times that are NaN", "x_ref.csv", ref_csv="time,y\nnan,0\n1,1\n"),
    _case("of values that are NaN", "", ref_csv="time,y\n0,0\n1,nan\n"),
    _case("of values that are infinite", "", ref_csv="time,y\n0,0\n1,inf\n"),
    _case("of a column twice", "x_ref.csv", ref_csv="time,y,y\n0,0,0\n1,1,1\n"),
    _case("of a name with an escape code", "", ref_csv="time,\x1b[2Jy\n0,0\n1,1\n"),
    _case("of a name that the FMU has not", "w", ref_csv="time,w\n0,0\n1,1\n"),
    _case("of 100,000 columns", "", ref_csv=",".join(["time", *(f"v{k}" for k in range(100_000))]) + "\n"),
    _case("of bytes that are not UTF-8", "x_ref.csv", ref_csv=b"time,y\n\xff\xfe\xff,1\n"),
    _case("in UTF-16", "", RUNS, ref_csv=_REFERENCE.encode("utf-16")),
    _case("with a byte order mark", "", RUNS, ref_csv=_REFERENCE.encode("utf-8-sig")),
    _case("cut off in a line", "", ref_csv="time,y\n0,0\n1,"),
    _case("of a quote that is not closed", "x_ref.csv", ref_csv='time,"y\n0,0\n1,1\n'),
    _case("of one very long line", "x_ref.csv", ref_csv="time,y\n" + "9" * 1_000_000),
    _case("that is an image", "x_ref.csv", ref_csv=b"\x89PNG\r\n\x1a\n" + bytes(200)),
    _case("that is Parquet by its name only", "x_ref.parquet", ref_csv=None, ref_parquet=b"PAR1" + bytes(100) + b"PAR1"),
    _case("that is MAT by its name only", "x_ref.mat", ref_csv=None, ref_mat=b"MATLAB 5.0 MAT-file" + bytes(200)),
    _case("that is npz by its name only", "x_ref.npz", ref_csv=None, ref_npz=b"PK\3\4" + bytes(100)),
    _case("that is JSON of a list", "x_ref.json", ref_csv=None, ref_json="[1, 2]"),
    _case("that is JSON, 5,000 nested lists", "x_ref.json", ref_csv=None, ref_json="[" * 5000 + "]" * 5000),
    _case("in two formats", "both there", ref_json='{"time": [0, 1], "y": [0, 1]}'),
    _case("of other values", "y", ref_csv="time,y\n0,0\n1,5\n"),
    _case("options that are empty", "", ref_opt=""),
    _case("options that are a text", "x_ref.opt", ref_opt="hello"),
    _case("options of zeros", "x_ref.opt", ref_opt=bytes(100)),
    _case("a step of 0, which says nothing", "", RUNS, ref_opt=_OPTIONS.replace("0.1", "0")),
    _case("a step of NaN", "x_ref.opt", ref_opt=_OPTIONS.replace("0.1", "NaN")),
    _case("a step that is not a number", "x_ref.opt", ref_opt=_OPTIONS.replace("0.1", "short")),
    _case("a stop of 1e300", "", ref_opt=_OPTIONS.replace("StopTime, 1", "StopTime, 1e300")),
    _case("tolerances that are a text", "x_ref.toml", ref_toml="hello"),
    _case("tolerances of an unknown key", "x_ref.toml", ref_toml="colour = 3\n"),
    _case("a tolerance of NaN", "x_ref.toml", ref_toml="relative = nan\n"),
    _case("a negative tolerance", "x_ref.toml", ref_toml="relative = -1.0\n"),
    _case("a tolerance that is a text", "x_ref.toml", ref_toml='relative = "small"\n'),
    _case("tolerances of 5,000 nested lists", "x_ref.toml", ref_toml="a = " + "[" * 5000 + "]" * 5000),
    _case("start values that are a number", "x_ref.toml", ref_toml="start = 3\n"),
    _case("an unknown solver, which nothing needs", "", RUNS, ref_toml='solver = "magic"\n'),
    _case("inputs that are a text", "x_in.csv", in_csv="hello"),
    _case("inputs that the FMU has not", "w", in_csv="time,w\n0,0\n1,1\n"),
    _case("inputs of times that descend", "x_in.csv", in_csv="time,u\n1,1\n0,0\n"),
    _case("inputs of NaN", "", in_csv="time,u\n0,nan\n1,1\n"),
)  # fmt: skip
