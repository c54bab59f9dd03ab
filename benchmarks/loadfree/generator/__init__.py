"""True events: bodies, contacts and equilibria in ten-node elements; nothing here comes from the package under test."""
