"""One report for sweeps, tuning, trials, comparisons and flights: a single HTML file that works offline."""
