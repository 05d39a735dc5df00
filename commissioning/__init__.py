"""From a device to a verified controller: safe range, recording, identification, controller, verification, report."""
