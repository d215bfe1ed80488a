/* A spring that slips along a path: see core/wing/effects/damping/hysteresis.py. */
#include "arrays.h"

/* Stretch (h, m) along each path of deflections (h, m), never beyond +-reach; it begins unstretched at 0. */
EXPORT int64_t slipping_spring(const array *deflection_in, double reach, const array *stretch_out)
{
    bool good = true;
    const double *deflection = reals(deflection_in, 2, &good);
    double *stretch = reals(stretch_out, 2, &good);
    if (!good || extent(stretch_out, 0) != extent(deflection_in, 0) ||
        extent(stretch_out, 1) != extent(deflection_in, 1))
        return BAD_ARRAY;
    int64_t count = extent(deflection_in, 1);
    for (int64_t row = 0; row < extent(deflection_in, 0); row++) {
        const double *w = deflection + row * count;
        double *path = stretch + row * count, held = 0.0, before = 0.0;
        for (int64_t i = 0; i < count; i++) {
            held += w[i] - before;
            held = held > reach ? reach : held < -reach ? -reach : held;
            before = w[i];
            path[i] = held;
        }
    }
    return 0;
}
