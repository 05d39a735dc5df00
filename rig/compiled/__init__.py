"""C backend of a run (`realtime.backend: c`): over UDP, the control loop in C."""
