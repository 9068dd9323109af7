"""The panels of the page, one file each: they translate between fields and the session."""
