"""`realtime.backend: c`: the controller of a run as C, and over UDP the whole sample."""
