"""Run a policy and a simulator as nodes of ROS, without Hydra: ``python -m gctd3.ros node=both policy=policy.onnx``."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from gctd3.config.help import fail, helped, unread
from gctd3.config.terminal import prepare_output
from gctd3.errors import ConfigError, GCTD3Error
from gctd3.signals import Interruption

if TYPE_CHECKING:
    from gctd3.bridge.settings import RosSettings

FAILED = 1  # exit code of a walk that failed


def _run(settings: RosSettings) -> int:
    # Late: the policy's node needs no simulator.
    if settings.node == "policy":
        from gctd3.bridge.policy_node import run_policy

        counts = run_policy(settings)
        print(f"policy: {counts.steps} steps, {counts.refused} refused, {counts.limited} limited.")
        return 0
    from gctd3.bridge.both import run_both
    from gctd3.bridge.simulator_node import run_simulator

    walk = run_both(settings) if settings.node == "both" else run_simulator(settings)
    print(walk.summary())
    return 0 if walk.walked else FAILED


def main() -> None:
    """Run ``python -m gctd3.ros``."""
    if helped("ros"):
        return
    from gctd3.bridge.arguments import parse
    from gctd3.bridge.settings import RosSettings

    heard = Interruption()
    prepare_output()
    try:
        with heard.listening():
            raise SystemExit(_run(parse(RosSettings, sys.argv[1:])))
    except ConfigError as error:
        fail(str(error))
    except BrokenPipeError:
        unread()
    except (GCTD3Error, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(FAILED) from None
    except KeyboardInterrupt:
        raise SystemExit(heard.exit_code) from None


if __name__ == "__main__":
    main()
