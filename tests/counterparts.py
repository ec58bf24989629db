"""Pair our parameters with those of Stable-Baselines3 that hold the same numbers."""

import torch
from torch import nn


def linear(network):
    return [layer for layer in network if isinstance(layer, nn.Linear)]


def parameters(algorithm, model):
    """Return, by name, our parameter, their parameters with the same numbers, and the function that joins these."""
    found = {}

    def add(name, params, layers, join):
        mine = [value for _, value in sorted(params.flatten_keys(".").items())]  # each layer's bias, then its weight
        theirs = [[getattr(part, kind) for part in layer] for layer in layers for kind in ("bias", "weight")]
        found.update({f"{name}.{i}": (*pair, join) for i, pair in enumerate(zip(mine, theirs, strict=True))})

    loss, twins = algorithm.loss, len(model.critic.q_networks) == 2
    critic = "qvalue_network_params" if twins else "value_network_params"
    for prefix, critics in (("", model.critic), ("target_", model.critic_target)):
        layers = list(zip(*map(linear, critics.q_networks), strict=True))
        add(f"{prefix}critic", getattr(loss, prefix + critic), layers, torch.stack if twins else torch.cat)
    if hasattr(loss, "log_alpha"):
        # Mean and deviation come from one layer of ours and two of theirs.
        layers = [*([layer] for layer in linear(model.actor.latent_pi)), [model.actor.mu, model.actor.log_std]]
        add("actor", loss.actor_network_params, layers, torch.cat)
        found["alpha"] = loss.log_alpha, [model.log_ent_coef], lambda values: values[0].squeeze()
    else:
        for prefix, actor in (("", model.actor), ("target_", model.actor_target)):
            layers = [[layer] for layer in linear(actor.mu)]
            add(f"{prefix}actor", getattr(loss, f"{prefix}actor_network_params"), layers, torch.cat)
    return found
