"""The guided bench: pages in a browser on the same commands. One server, one `Bench`, any number of browsers."""
