from .recordings import open_recording as open_recording, write_recording as write_recording
from .recording_views import read as read
