"""What travels from sensors to the fusion centre: messages as bytes, and what they take of a link."""
