"""Studies and checks on top of everything: the papers, closed-loop control, the blind check, speed, faults."""
