"""Every text that a user hands in: read with limits on its size, and by stated types, units and ranges; where files lie."""
