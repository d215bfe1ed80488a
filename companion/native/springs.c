/* A spring that slips along a path: see core/wing/effects/damping/hysteresis.py. */
#include "arrays.h"

#include <math.h>

enum { REMEMBERED = 32 }; /* instants of slip that a stretch depends on at most (choice: mostly it is one) */
static const double FORGOTTEN = 1e-6; /* weight at which such an instant no longer counts (numerical) */

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

/* Where a stretch comes from: instants of the last slips, and how much of it began at each. */
typedef struct {
    int64_t at[REMEMBERED];
    double share[REMEMBERED];
    int count;
} slips;

static void forget(slips *past, double kept)
{
    int count = 0;
    for (int j = 0; j < past->count; j++) {
        double share = past->share[j] * kept;
        if (share > FORGOTTEN) {
            past->at[count] = past->at[j];
            past->share[count++] = share;
        }
    }
    past->count = count;
}

static void slip(slips *past, int64_t at, double share)
{
    if (past->count == REMEMBERED) {
        past->count--;
        for (int j = 0; j < past->count; j++) {
            past->at[j] = past->at[j + 1];
            past->share[j] = past->share[j + 1];
        }
    }
    past->at[past->count] = at;
    past->share[past->count++] = share;
}

/* Adds to lags (h, m) the derivative of the stretch by the deflection so many samples before, summed with weights (m).
 *
 * A spring that holds follows the deflection (lag 0), less that of the instant at which it last slipped. A step within
 * which it begins to slip counts by the part of the step in which it does.
 */
EXPORT int64_t slipping_spring_derivatives(const array *deflection_in, double reach, const array *weights_in,
                                           const array *lags_out)
{
    bool good = true;
    const double *deflection = reals(deflection_in, 2, &good), *weights = reals(weights_in, 1, &good);
    double *lags = reals(lags_out, 2, &good);
    if (!good || extent(lags_out, 0) != extent(deflection_in, 0) ||
        extent(lags_out, 1) != extent(deflection_in, 1) || extent(weights_in, 0) != extent(deflection_in, 1))
        return BAD_ARRAY;
    int64_t count = extent(deflection_in, 1);
    for (int64_t row = 0; row < extent(deflection_in, 0); row++) {
        const double *w = deflection + row * count;
        double *lag = lags + row * count, held = 0.0, before = 0.0;
        slips past = {.count = 0};
        for (int64_t i = 0; i < count; i++) {
            double step = w[i] - before, free = held + step;
            held = free > reach ? reach : free < -reach ? -reach : free;
            before = w[i];
            double slipped = free == held ? 0.0 : least(fabs(free - held) / fabs(step), 1.0);
            forget(&past, 1.0 - slipped);
            lag[0] += weights[i] * (1.0 - slipped);
            for (int j = 0; j < past.count; j++)
                lag[i - past.at[j]] -= weights[i] * past.share[j];
            if (slipped > 0.0)
                slip(&past, i, slipped);
        }
    }
    return 0;
}
