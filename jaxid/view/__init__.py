"""Pages that answer while they are looked at: results side by side, a recording being made."""
