"""Commands about detectors: trained, run and measured."""
