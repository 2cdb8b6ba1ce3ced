"""The criterion of Van Henten et al. 2010 in plain Python."""


def printed_cost(tip, target, distance_mm):
    """(3) to (6) of Van Henten et al. 2010, word by word; lengths in millimetres."""
    r11, r21, r31, r32, r33 = tip[0, 0], tip[1, 0], tip[2, 0], tip[2, 1], tip[2, 2]
    px, py, pz = 1000.0 * tip[:3, 3]
    x, y, z = 1000.0 * target
    j_pos = ((x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2) ** 0.5
    j_ori = (r11**2 + r21**2 + (1.0 + r31) ** 2 + r32**2 + r33**2) ** 0.5
    if distance_mm == 0.0:
        j_dist = 1.0
    elif distance_mm <= 75.0:
        j_dist = 1.0 - distance_mm / 75.0
    else:
        j_dist = 0.0
    return j_pos + j_ori + j_dist
