"""What every stage may use and what no stage decides: files as values, options, summaries, the clock."""
