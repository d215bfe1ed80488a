"""The inner loops in C: against their readable versions, and under the sanitizers."""
