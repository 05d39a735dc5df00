"""The papers' studies: every model trained, exported and tested, its tables beside what the papers print.

A study is a list of jobs (`job`): each trains one model, exports it and scores it. `s1`, `s2_tables` with `s2_report`,
and `real` say which jobs a study has and what is shown of their results; `study` holds the three.
"""
