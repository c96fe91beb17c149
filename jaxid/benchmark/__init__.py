"""The public yardstick: blind cases whose gaps are known, and what answers to them are worth."""
