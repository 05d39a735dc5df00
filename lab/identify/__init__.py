"""The identification study: devices drawn at random, identified from logs, controlled as identified, against bars."""
