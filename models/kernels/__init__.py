"""Roll-outs and exact sensitivities of recurrent networks."""
