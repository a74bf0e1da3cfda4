"""Counting: trips, speeds, queues and conflicts of tracks or of true road users."""
