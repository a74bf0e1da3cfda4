from .recordings import open_samples as open_samples, read as read, write_samples as write_samples
from .sample import Sample as Sample, SensorCloud as SensorCloud
