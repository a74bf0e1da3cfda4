"""`python -m coview`: the command line."""

from coview.main import main

if __name__ == "__main__":
    main()
