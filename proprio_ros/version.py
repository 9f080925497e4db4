"""The version of the package; `package.xml`, `setup.py` and `CITATION.cff` say the same."""

__version__ = "0.9.0"
