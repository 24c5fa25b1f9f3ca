"""From simulation to a real robot, paper IV-C."""

import gymnasium

gymnasium.register("NavBot-lab-v1", entry_point="robot.environment:RealEnv",
                   vector_entry_point="robot.environment:RealVecEnv", kwargs={"scenes": ("lab",)},
                   max_episode_steps=200)
