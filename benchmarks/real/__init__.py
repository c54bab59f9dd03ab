"""Registration without a known load on measured bodies: a hydrogel with thousands of beads, a silicone beam."""
