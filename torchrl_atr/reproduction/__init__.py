"""The paper's figures and tables, each made anew from policies by one command (docs/reproduce.md)."""
