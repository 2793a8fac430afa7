"""``python -m undrift``: run the command line if the script is not on the path."""

from undrift.cli.app import main

if __name__ == "__main__":
    main()
