"""Engine in C99: what runs at every sample, on a person's machine and on the exported controller alike."""
