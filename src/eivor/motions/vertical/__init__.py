"""The vertical motion of a multirotor."""
