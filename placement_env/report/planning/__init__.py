"""Planning: from a question to a plan. It uses search, judgement on traffic that no search saw, and
plain figures."""
