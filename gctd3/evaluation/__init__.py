"""Evaluation: rollouts, gait metrics, perturbations, robustness."""
