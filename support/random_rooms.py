"""Level 3 as an environment, `NavBot-random-v1`, for learners that do not change rooms."""

import numpy as np

from navbot_min import MAX_EPISODE_STEPS, NavEnv, NavVecEnv
from scenes.generate import MOST_SEED
from support.checks import check
from support.rooms import FIRST_ROOM, change_room, training_room

EPISODES_PER_ROOM = 16  # about as many as in our training


class RandomRoomsVecEnv(NavVecEnv):
    """Level 3 for any learner: each robot runs EPISODES_PER_ROOM episodes in one random room and
    then in the next. Rooms follow from the environment's seed, and are never validation rooms.
    Targets and starts are drawn as in our training. When a step returns the `final_info` of the
    last episode in a room, `env.scenes` already has the next room."""

    def __init__(self, num_envs=32, max_episode_steps=MAX_EPISODE_STEPS):
        """Arguments: as for NavVecEnv."""
        check(num_envs >= 1, f"num_envs is {num_envs}; it must be at least 1")
        rooms = [training_room(FIRST_ROOM)] * num_envs  # until the first reset
        super().__init__(num_envs, rooms, "anywhere", max_episode_steps=max_episode_steps)
        # Episodes that each robot has driven in its room. The first reset changes all rooms.
        self._episodes = np.full(num_envs, EPISODES_PER_ROOM)

    def reset(self, *, seed=None, options=None):
        """Starts an episode for every robot; with a seed, in new rooms. Raises ValueError."""
        check(not options, f"options is {options!r}; in random rooms there are none")
        if self._steps is not None:
            self._episodes += self._steps > 0  # the episodes that this reset cuts short
        if seed is not None:
            self.leave_rooms()
        return super().reset(seed=seed)

    def leave_rooms(self):
        """Makes each robot change to a new room before its next episode."""
        self._episodes[:] = EPISODES_PER_ROOM

    def sample_episode(self, r):
        """Draws robot r's next episode, and from time to time its next room."""
        self._episodes[r] += self._steps[r] > 0  # not an episode that a reset replaces at once
        if self._episodes[r] >= EPISODES_PER_ROOM:
            number = int(self.np_random.integers(FIRST_ROOM, MOST_SEED))
            change_room(self, r, training_room(number))
            self._episodes[r] = 0
        return super().sample_episode(r)


class RandomRoomsEnv(NavEnv):
    """One robot of RandomRoomsVecEnv, without autoreset."""
    vector_class = RandomRoomsVecEnv

    def reset(self, *, seed=None, options=None):
        """Starts an episode; with a seed, in a new room. Raises ValueError."""
        if seed is not None:
            self.vector.leave_rooms()
        return super().reset(seed=seed, options=options)
