"""The paper's study, its readings and errata."""
