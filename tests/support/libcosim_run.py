"""A run by libcosim, for a process of its own: it takes an SSP, and values of `A` say which variables to report."""

from __future__ import annotations

LIBCOSIM = """
from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver

log_output_level(CosimLogLevel.WARNING)
execution = CosimExecution.from_ssp_file(ssp_path=A.ssp)  # with the step of the SSP
slaves = {info.name.decode(): info.index for info in execution.slave_infos()}
observer = CosimObserver.create_time_series(buffer_size=A.n + 1)
assert execution.add_observer(observer=observer)
references = {}
for path in A.names:
    name, _, variable = path.partition(".")
    known = {v.name.decode(): v.reference for v in execution.slave_variables(slave_index=slaves[name])}
    references[path] = (slaves[name], known[variable])
    assert observer.start_time_series(
        slave_index=slaves[name], value_reference=known[variable], variable_type=CosimVariableType.REAL
    )
assert execution.step(step_count=A.n)
result = {}
for path, (slave, reference) in references.items():
    times, steps, values = observer.time_series_real_samples(
        slave_index=slave, value_reference=reference, from_step=1, sample_count=A.n
    )
    result[path] = list(values)
result["time"] = [t * 1e-9 for t in times]
report(result)
"""
