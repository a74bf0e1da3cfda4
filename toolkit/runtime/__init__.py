"""How jobs run: files written whole, processes and Ray, what is kept on disk, work that survives being killed."""
