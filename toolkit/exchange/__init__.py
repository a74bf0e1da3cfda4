"""Writers of detections and tracks in the formats of other programs."""
