"""Commands that set up, check and measure."""
