"""The papers' studies: every model trained, exported and tested, its tables beside what the papers print.

A study is a list of jobs (`job`), each pure: it trains one model, exports it and scores it (`worker`); `pool` runs them
in parallel and goes on where a study stopped. `s1_plan`, `s2_plan` and `real_plan` say which jobs a study has,
`s1_report`, `s2_report` and `real_report` what is shown of their results, `run.run_study` does the whole.
"""
