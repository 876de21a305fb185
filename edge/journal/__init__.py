"""What happened, one JSON object a line."""
