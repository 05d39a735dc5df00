"""The wire between loop and device, behind one small protocol."""
