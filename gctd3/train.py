"""Train a policy: ``python -m gctd3.train algo=gctd3``."""

from __future__ import annotations

from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from gctd3.cli import command
from gctd3.settings import build

INTERRUPTED = 130  # what a shell reports of a program that Ctrl-C ended


def train(config: DictConfig) -> None:
    """Check the configuration, train, say what was reached."""
    # Imported late, so that --help and a mistyped key are answered at once.
    from gctd3.trainer import Trainer

    settings = build(config)
    directory = Path(HydraConfig.get().runtime.output_dir)
    trainer = Trainer(settings, directory)
    OmegaConf.resolve(config)
    OmegaConf.save(config, directory / ".hydra" / "config.yaml")
    print(OmegaConf.to_yaml(config))
    print(f"Run directory: {directory}\n", flush=True)
    interrupted = False
    try:
        trainer.run()
    except KeyboardInterrupt:
        interrupted = True
        print("\nInterrupted; the best policy so far is kept.")
    best = trainer.best
    if best is None:
        print("It had not been evaluated yet, so there is none.")
        raise SystemExit(INTERRUPTED)
    print(
        f"\nBest evaluation, after {best['frames']:,.0f} steps and {best['wall_s'] / 60:.1f} minutes: "
        f"return {best['return_mean']:.1f} ± {best['return_std']:.1f}, success {best['success_rate']:.0%}, "
        f"{best['distance_mean']:.1f} m at {best['velocity_mean']:.2f} m/s.\n"
        f"Judge it over 50 episodes:  python -m gctd3.evaluate run={directory} episodes=50"
    )
    if interrupted:
        raise SystemExit(INTERRUPTED)


def main() -> None:
    """Entry point of ``python -m gctd3.train``."""
    command("config", train)


if __name__ == "__main__":
    main()
