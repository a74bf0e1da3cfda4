"""Counting: what tracks or true road users say about a street: ways, speeds, queues, conflicts."""
