"""`python -m jaxik` is the command `jaxik`."""

from jaxik.cli import main

if __name__ == "__main__":
    main()
