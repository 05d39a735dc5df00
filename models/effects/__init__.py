"""Effects of real devices beyond a simulator, each an operator on the command side or the output side of a chain."""
