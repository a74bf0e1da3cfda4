"""Planning: from a question to a plan, by search, judgement on traffic that no search saw, and plain figures."""
