"""The catheters of the papers S1 and S2 and a rod as simulated devices with their benches.

`tendon`, `muscle` and `rod` are the devices, `recorder` the sensors. The devices are not made of the operators that are
identified on them (`models.operators`).
"""
