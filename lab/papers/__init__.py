"""Studies of the papers: every model is trained, exported and tested, and compared with the papers' tables.

A study is a list of jobs (`job`): each trains one model, exports it and scores it. `s1`, `s2_tables` with `s2_report`,
and `real` define the jobs of a study and the display of their results; `study` holds the three.
"""
