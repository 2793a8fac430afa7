"""Pages of the bench, one file each: `page(bench)` builds it for one browser."""
