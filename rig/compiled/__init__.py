"""C backend of a run (`realtime.backend: c`): the compiled controller and, over UDP, the control loop in C."""
