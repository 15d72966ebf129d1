"""Train a policy that brings the Tripod's effector to a goal, and write it as ONNX for `softsim run policy`.

    pip install 'softsim[learn,policy,train]'
    python examples/learning/train_tripod_reach.py

Writes tripod_reach.onnx and tripod_reach.png, its learning curve, beside this file. Proximal policy
optimisation on the CPU; see docs/learning.md for what was measured.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import helper, numpy_helper
from stable_baselines import Robots
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

from softsim_core import policy_metadata

TASK = "TripodReach-v0"
HERE = Path(__file__).parent


class Curve(BaseCallback):
    """Steps, share of episodes that ended within 2 mm, and median distance in [mm], of each rollout."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[tuple[int, float, float]] = []
        self._ended: list[tuple[bool, float]] = []
        self._started = time.perf_counter()

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        self._ended += [
            (bool(e["is_success"]), 1e3 * float(e["distance_m"])) for e in infos if "distance_m" in e
        ]
        return True

    def _on_rollout_end(self) -> None:
        if len(self._ended) < 64:
            return
        success, distance = np.array(self._ended, dtype=float).T
        self._ended = []
        self.rows.append((self.num_timesteps, float(success.mean()), float(np.median(distance))))
        spent = time.perf_counter() - self._started
        print(
            f"{self.rows[-1][0]:8d} steps, {spent:6.0f} s: {success.mean():.2f} within 2 mm, "
            f"median {self.rows[-1][2]:.2f} mm",
            flush=True,
        )


def write_onnx(model: PPO, scale: VecNormalize, file: Path) -> None:
    """The mean action as a graph: (n, m) observations as they come in, (n, j) actions from -1 to 1."""
    running = scale.obs_rms
    spread = np.sqrt(running.var + scale.epsilon)
    constants = {
        "mean": running.mean,
        "spread": spread,
        "limit": np.array(scale.clip_obs),
        "low": np.array(-1.0),
    }
    constants |= {"negative_limit": -constants["limit"], "high": np.array(1.0)}
    nodes = [
        helper.make_node("Sub", ["observation", "mean"], ["centred"]),
        helper.make_node("Div", ["centred", "spread"], ["scaled"]),
        helper.make_node("Clip", ["scaled", "negative_limit", "limit"], ["hidden_0"]),
    ]
    layers = [each for each in model.policy.mlp_extractor.policy_net if isinstance(each, torch.nn.Linear)]
    for k, layer in enumerate([*layers, model.policy.action_net]):
        constants |= {f"weight_{k}": layer.weight.detach().numpy(), f"bias_{k}": layer.bias.detach().numpy()}
        linear = "action_mean" if k == len(layers) else f"linear_{k}"
        nodes.append(
            helper.make_node("Gemm", [f"hidden_{k}", f"weight_{k}", f"bias_{k}"], [linear], transB=1)
        )
        if k < len(layers):
            nodes.append(helper.make_node("Tanh", [linear], [f"hidden_{k + 1}"]))
    nodes.append(helper.make_node("Clip", ["action_mean", "low", "high"], ["action"]))
    number = onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        nodes,
        TASK.partition("-")[0],
        [helper.make_tensor_value_info("observation", number, ["n", len(running.mean)])],
        [helper.make_tensor_value_info("action", number, ["n", model.action_space.shape[0]])],
        [
            numpy_helper.from_array(np.asarray(value, dtype=np.float32), name)
            for name, value in constants.items()
        ],
    )
    found = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(found, policy_metadata(TASK))
    onnx.checker.check_model(found, full_check=True)
    onnx.save(found, file)


def draw(rows: list[tuple[int, float, float]], file: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    steps, success, distance = np.array(rows).T
    figure, left = pyplot.subplots(figsize=(6.0, 3.2), layout="constrained")
    left.plot(steps, 100.0 * success, color="#1f5f8b")
    left.set(xlabel="environment steps", ylabel="episodes that end within 2 mm [%]", ylim=(0.0, 100.0))
    right = left.twinx()
    right.plot(steps, distance, color="#c0562b")
    right.set(ylabel="median distance at the end [mm]", ylim=(0.0, None))
    left.yaxis.label.set_color("#1f5f8b")
    right.yaxis.label.set_color("#c0562b")
    figure.savefig(file, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--steps", type=int, default=120_000, help="of all robots together")
    parser.add_argument("--robots", type=int, default=32)
    parser.add_argument("--workers", type=int, default=2, help="on how many cores")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--randomise", help="file of what differs from episode to episode; about 0.1 s each")
    parser.add_argument("--out", type=Path, default=HERE / "tripod_reach.onnx")
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    options: dict[str, Any] = {"workers": chosen.workers, "randomise": chosen.randomise}
    robots = VecNormalize(
        Robots(f"softsim/{TASK}", chosen.robots, chosen.seed, **options), norm_reward=False, clip_obs=10.0
    )
    model = PPO(
        "MlpPolicy",
        robots,
        n_steps=25,
        batch_size=100,
        n_epochs=6,
        gamma=0.8,
        gae_lambda=0.9,
        learning_rate=lambda left: 1e-3 * (0.1 + 0.9 * left),
        policy_kwargs={"net_arch": [32, 32], "log_std_init": -1.0},
        seed=chosen.seed,
        device="cpu",
    )
    curve = Curve()
    model.learn(chosen.steps, callback=curve)
    robots.close()
    write_onnx(model, robots, chosen.out)
    draw(curve.rows, chosen.out.with_suffix(".png"))
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    seconds = sum(each.ru_utime + each.ru_stime for each in spent)
    print(f"{chosen.out}: {model.num_timesteps} steps, {seconds:.0f} s of processor time")


if __name__ == "__main__":
    main()
