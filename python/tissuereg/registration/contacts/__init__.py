"""Registration without a known load: sparse contacts on the free surface as the prior."""
