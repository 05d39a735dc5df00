"""Recording of a run outside the control thread: log.csv, log.mcap and report.html of a run folder."""
