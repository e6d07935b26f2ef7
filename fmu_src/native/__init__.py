"""The native target: CasADi's C, the shell around it, and the compiler for all platforms."""
