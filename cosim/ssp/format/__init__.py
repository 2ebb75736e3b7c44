"""The files of an SSP: packages, descriptions, parameter sets, diagrams, as the standard has them; no `System` yet."""
