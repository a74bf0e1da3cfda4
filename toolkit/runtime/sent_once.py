"""`SentOnce`: objects that processes get once for all jobs."""


class SentOnce:
    """Base class of objects that a process gets once, however many jobs refer to them.

    Such an object must not change once a job with it began, since a process keeps its copy until
    the object itself is gone. What it computes and keeps for itself may change."""
