"""Recording of a run outside the control thread: log.csv, log.mcap and report.html of a run folder."""

from .apart import Apart, open_apart
from .fan import Fan
from .recording import Recording, RecordingMeta, open_recording

__all__ = ["Apart", "Fan", "Recording", "RecordingMeta", "open_apart", "open_recording"]
