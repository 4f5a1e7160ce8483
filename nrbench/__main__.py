"""Run the command line by ``python -m nrbench``."""

from nrbench.cli.main import main

if __name__ == "__main__":
    main()
