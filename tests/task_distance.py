"""The distance of a pose to what a task allows, by NumPy and SciPy."""

import numpy as np
from scipy.spatial.transform import Rotation


def distances(task, tip, target):
    """The distances to the set [m], [rad] by NumPy and SciPy, of a task with regions of the pose."""
    inside = task.axes == "tool"
    apart = tip[:3, 3] - target[:3, 3]
    apart = target[:3, :3].T @ apart if inside else apart
    turn = target[:3, :3].T @ tip[:3, :3] if inside else tip[:3, :3] @ target[:3, :3].T
    log = Rotation.from_matrix(turn).as_rotvec()
    twist = [
        2.0 * np.arctan2(Rotation.from_matrix(turn).as_quat()[i], Rotation.from_matrix(turn).as_quat()[3]) for i in range(3)
    ]
    free = [i for i in range(3) if not task.bound[3 + i]]
    if len(free) == 1:  # the shortest turn of the free axis
        axis = turn[:, free[0]]
        across = np.cross(np.eye(3)[free[0]], axis)
        log = across / np.linalg.norm(across) * np.arctan2(np.linalg.norm(across), axis[free[0]])
    if len(free) == 2:
        log = np.array([(t + np.pi) % (2.0 * np.pi) - np.pi for t in twist])
    values = np.concatenate([apart, log])

    def nearest(numbers, low, high):
        if len(numbers) == 1:
            value = values[numbers[0]]
            return max(low - value, value - high, 0.0)
        norm = np.linalg.norm(values[list(numbers)])
        return max(low - norm, norm - high, 0.0)

    taken = {i for region in task.within for i in region.components}
    parts = [
        [abs(values[i]) for i in range(6) if task.bound[i] and i not in taken and (i < 3) == (kind == 0)] for kind in (0, 1)
    ]
    for numbers, low, high in task.within:
        parts[numbers[0] >= 3].append(nearest(numbers, low, high))
    return [float(np.linalg.norm(part)) for part in parts]
