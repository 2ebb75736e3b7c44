"""What `cosim.sweep` exports."""

from __future__ import annotations

import subprocess
import sys


def test_every_name_is_there_also_after_its_module_was_imported():
    import cosim.sweep.engine  # a module of a function's name would take its place

    assert cosim.sweep.__all__
    assert cosim.sweep.__all__ == sorted(cosim.sweep.__all__)
    for name in cosim.sweep.__all__:
        assert callable(getattr(cosim.sweep, name)), name


def test_dask_is_imported_with_what_needs_it_only():
    code = (
        "import sys; from cosim.sweep import Range, design; design('lhs', [Range('a.x', 0, 1)], 4); "
        "print({m.partition('.')[0] for m in sys.modules} & {'dask', 'distributed', 'pyarrow'})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
