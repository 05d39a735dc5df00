"""The papers' two catheters as simulated instruments, and the data sets that are recorded on them.

`tendon` and `muscle` are the devices, `sensors` their measuring chains, `tendon_recorder` and `muscle_recorder` the
protocols by which a trial is taken, `make.make_dataset` the papers' full data sets. The devices are not made of the
operators that are identified on them (`models.operators`).
"""
