"""Running jobs: whole files, processes and Ray, caches, resumable work."""
