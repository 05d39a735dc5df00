"""The simulated device as an environment of gymnasium, for public samplers and libraries of reinforcement learning.

`gym_.HysteresisEnv` needs gymnasium, an extra: `pip install 'hystmpc[env]'`.
"""
