from .recordings import (
    open_recording as open_recording,
    read as read,
    write_recording as write_recording,
)
