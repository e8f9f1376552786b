"""Every unknown and its prior: `priors` of motor and instruments, `effects` of what may be missing."""
