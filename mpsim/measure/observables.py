def kinetic_energy(state, scene):
    return float((state.velocity.astype(float) ** 2).sum() / 2)


def temperature(state, scene):
    return float((state.velocity.astype(float) ** 2).mean())


def speed_kurtosis(state):
    v = (state.velocity.astype(float) ** 2).sum(axis=1)
    return float((v * v).mean() / v.mean() ** 2)
