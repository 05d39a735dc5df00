"""Safety of a device: what may be sent, what is believed, when and how a run stops."""
