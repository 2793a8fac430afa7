"""What every stage may use and what no stage decides: options, summaries, the clock. It knows no stage."""
