"""Benchmarks are run by `make bench`, not as tests."""

collect_ignore_glob = ["*"]
