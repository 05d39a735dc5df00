"""Closed loop in simulation: plants with injectable effects, sweeps, tuning, metrics, reports.

A study is a `config.SimulationConfig`; `study.prepare` makes it ready, `compare.compare` runs every controller along
every motion and leaves a run folder, `report.report_from_folder` writes its page anew. `compare.demo` runs the study
that ships with the package.
"""
