"""Command line by ``python -m mufly``, for systems without the script ``mufly`` on the path."""

from mufly.cli import main

if __name__ == "__main__":
    main()
