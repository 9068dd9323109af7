"""From what the user wants to certified gains."""
