"""Selection of effects: score tests, fits, penalised likelihood, cross-validation, lack of fit."""
