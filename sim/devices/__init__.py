"""The catheters of the papers S1 and S2 and a rod as simulated devices, and the papers' data sets.

`tendon`, `muscle` and `rod` are the devices with their benches, `recorder` the sensors; `paper_data.make_dataset`
records the papers' full data sets. The devices are not made of the operators that are identified on them
(`models.operators`).
"""
