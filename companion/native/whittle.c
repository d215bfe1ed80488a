/* Spectrum of a family's acceleration (adaptation/model_spectrum.py) and the Whittle fit of its parameters
 * (adaptation/whittle.py). The text of these files has the equations. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "arrays.h"
#include "linear.h"

enum { FREQUENCY, DAMPING, LOAD, CORNER_1, CORNER_2, FIRST_PARAMETERS }; /* tracking/parameters.py */
enum { COHERENCE = 3, FURTHER_PARAMETERS = 4, MOST_MODES = 16 };
enum { MOST_PARAMETERS = FIRST_PARAMETERS + FURTHER_PARAMETERS * (MOST_MODES - 1) };
enum { COARSE_POINTS = 24, ALIAS_ORDERS = 4 }; /* numerical: model_spectrum.py */

#define MAX_LOG_STEP 1.0    /* numerical: a factor of e in one step */
#define CONVERGED 0.02      /* numerical, log posterior: far below one sigma */
#define MAX_DAMPING 1e4     /* numerical: Levenberg-Marquardt gives up */
#define MIN_EXPECTED 1e-12  /* numerical, (m/s^2)^2/Hz: below any sensor's noise */

typedef struct {
    const array *square, *epoch_gain, *alias_square, *alias_gain, *before, *fraction;
} grid_record;

typedef struct {
    const array *power, *frequency_hz, *weight;
    grid_record grid;
    const array *noise_density, *kernel;
    int64_t stride, low_bins, low_grid;
} periodogram_record;

typedef struct {
    const array *mean, *sigma, *low, *high, *reference_hz, *first, *end, *further, *further_first;
} prior_record;

typedef struct {
    const double *square, *gain;
    int64_t length;
} points;

typedef struct {
    points exact, aliases;
    const int64_t *before;
    const double *fraction;
} grid;

/* One family at given parameters, as far as it does not depend on the frequency. */
typedef struct {
    int64_t modes, parameters;
    double reference_hz, at_reference, inverse_1, inverse_2;
    double values[MOST_PARAMETERS], coherence[MOST_MODES], ratio[MOST_MODES];
    double load_slope[MOST_MODES][2]; /* of a load, where it is stated, by either corner */
} family;

/* Place of a mode's frequency; its damping and load follow. */
static int64_t place_of(int64_t mode)
{
    return mode == 0 ? FREQUENCY : FIRST_PARAMETERS + FURTHER_PARAMETERS * (mode - 1);
}

static void describe(const double *log_params, int64_t count, double reference_hz, family *f)
{
    f->parameters = count;
    f->modes = 1 + (count - FIRST_PARAMETERS) / FURTHER_PARAMETERS;
    f->reference_hz = reference_hz;
    for (int64_t k = 0; k < count; k++)
        f->values[k] = exp(log_params[k]);
    const double *v = f->values;
    f->inverse_1 = 1.0 / squared(v[CORNER_1]);
    f->inverse_2 = 1.0 / squared(v[CORNER_2]);
    f->at_reference = (1.0 + squared(reference_hz) * f->inverse_1) * (1.0 + squared(reference_hz) * f->inverse_2);
    f->coherence[0] = f->ratio[0] = 1.0;
    for (int64_t k = 1; k < f->modes; k++) {
        int64_t at = place_of(k);
        double square = squared(v[at + COHERENCE]), first = squared(reference_hz), own = squared(v[at]);
        f->coherence[k] = (square - 1.0) / (square + 1.0);
        f->ratio[k] = v[at + LOAD] / v[LOAD]; /* all loads have one shape, each is stated at its own frequency */
        for (int64_t which = CORNER_1; which <= CORNER_2; which++)
            f->ratio[k] *= (squared(v[which]) + own) / (squared(v[which]) + first);
    }
    for (int64_t k = 0; k < f->modes; k++) {
        double stated = squared(k == 0 ? reference_hz : v[place_of(k)]);
        for (int which = 0; which < 2; which++)
            f->load_slope[k][which] = 2.0 * stated / (squared(v[CORNER_1 + which]) + stated);
    }
}

/* Points of the grid that are worked on at once: loops over them are done by the processor's vectors. */
enum { BLOCK = 32 };
_Static_assert((int)COARSE_POINTS <= (int)BLOCK, "the coarse points are one block");

typedef double lane[BLOCK];

/* Density by each mode alone, and what its pairs need, at some squared frequencies. */
typedef struct {
    lane load, alone[MOST_MODES], apart[MOST_MODES], size[MOST_MODES], resisted[MOST_MODES];
} terms;

static double resisted(const double *v, int64_t at, int64_t other)
{
    return 4.0 * v[at + DAMPING] * v[other + DAMPING] * v[at] * v[other];
}

static void find_terms(const family *f, const double *restrict square, const double *restrict gain, int count,
                       terms *restrict t)
{
    const double *v = f->values;
    double inverse_1 = f->inverse_1, inverse_2 = f->inverse_2, stated = v[LOAD] * f->at_reference;
    for (int i = 0; i < count; i++)
        t->load[i] = gain[i] * (stated / ((1.0 + square[i] * inverse_1) * (1.0 + square[i] * inverse_2)));
    for (int64_t k = 0; k < f->modes; k++) {
        int64_t at = place_of(k);
        double own = squared(v[at]), resistance = resisted(v, at, at), ratio = f->ratio[k];
        for (int i = 0; i < count; i++) {
            t->apart[k][i] = own - square[i];
            t->resisted[k][i] = resistance * square[i];
            t->size[k][i] = square[i] / (squared(t->apart[k][i]) + t->resisted[k][i]);
            t->alone[k][i] = t->load[i] * ratio * t->size[k][i] * square[i];
        }
    }
}

/* Density by a pair under fully coherent loads, over a_j a_k + b_j b_k; and this factor. */
static void find_common(const family *f, const terms *restrict t, int64_t j, int64_t k, const double *restrict square,
                        int count, double *restrict common, double *restrict factor)
{
    double resistance = resisted(f->values, place_of(j), place_of(k)), ratio = sqrt(f->ratio[j] * f->ratio[k]);
    for (int i = 0; i < count; i++) {
        factor[i] = t->apart[j][i] * t->apart[k][i] + resistance * square[i];
        common[i] = 2.0 * t->load[i] * ratio * t->size[j][i] * t->size[k][i];
    }
}

/* Densities at some points. */
static void find_density(const family *f, const double *restrict square, const double *restrict gain, int count,
                         double *restrict out)
{
    terms t;
    lane common, factor;
    find_terms(f, square, gain, count, &t);
    for (int i = 0; i < count; i++)
        out[i] = 0.0;
    for (int64_t k = 0; k < f->modes; k++)
        add_scaled(out, t.alone[k], 1.0, count);
    for (int64_t k = 0; k < f->modes; k++)
        for (int64_t j = 0; j < k; j++) {
            double both = f->coherence[j] * f->coherence[k];
            find_common(f, &t, j, k, square, count, common, factor);
            for (int i = 0; i < count; i++)
                out[i] += both * (common[i] * factor[i]);
        }
}

/* Derivatives through the pairs: in `by` what goes through a_j a_k + b_j b_k and the coherences, in `shared` the sum of
 * each mode's joint densities; the density of all pairs is added to `density`. */
static void add_pairs(const family *f, const terms *restrict t, const double *restrict square, int count,
                      lane *restrict by, lane *restrict shared, double *restrict density)
{
    const double *v = f->values;
    lane plain, factor;
    for (int64_t k = 0; k < f->modes; k++)
        for (int64_t j = 0; j < k; j++) {
            int64_t at = place_of(k), other = place_of(j);
            double both = f->coherence[j] * f->coherence[k], resistance = resisted(v, other, at);
            double own = squared(v[at]), others = squared(v[other]);
            double by_own = (1.0 - squared(f->coherence[k])) * f->coherence[j];
            double by_other = (1.0 - squared(f->coherence[j])) * f->coherence[k];
            find_common(f, t, j, k, square, count, plain, factor);
            for (int i = 0; i < count; i++) {
                double joint = plain[i] * factor[i], common = both * plain[i];
                double through = common * (resistance * square[i]);
                density[i] += both * joint;
                shared[j][i] += both * joint;
                shared[k][i] += both * joint;
                by[at][i] += 2.0 * common * own * t->apart[j][i] + through;
                by[other][i] += 2.0 * common * others * t->apart[k][i] + through;
                by[at + DAMPING][i] += through;
                by[other + DAMPING][i] += through;
                by[at + COHERENCE][i] += by_own * joint;
                if (j > 0)
                    by[other + COHERENCE][i] += by_other * joint;
            }
        }
}

/* Densities at some points and their derivatives by the log parameters, into `by`. */
static void find_gradient(const family *f, const double *restrict square, const double *restrict gain, int count,
                          double *restrict density, lane *restrict by)
{
    terms t;
    const double *v = f->values;
    lane shared[MOST_MODES];
    find_terms(f, square, gain, count, &t);
    memset(density, 0, (size_t)count * sizeof *density);
    memset(by, 0, (size_t)f->parameters * sizeof *by);
    memset(shared, 0, (size_t)f->modes * sizeof *shared);
    add_pairs(f, &t, square, count, by, shared, density);
    for (int64_t k = 0; k < f->modes; k++) {
        int64_t at = place_of(k);
        double own = squared(v[at]);
        for (int i = 0; i < count; i++) {
            double response = t.alone[k][i] + shared[k][i], size = squared(t.apart[k][i]) + t.resisted[k][i];
            by[at + FREQUENCY][i] -= response * (4.0 * own * t.apart[k][i] + 2.0 * t.resisted[k][i]) / size;
            by[at + DAMPING][i] -= response * 2.0 * t.resisted[k][i] / size;
            by[at + LOAD][i] = t.alone[k][i] + 0.5 * shared[k][i];
            density[i] += t.alone[k][i];
        }
    }
    for (int which = CORNER_1; which <= CORNER_2; which++)
        for (int i = 0; i < count; i++)
            by[which][i] = density[i] * 2.0 * square[i] / (squared(v[which]) + square[i]);
    for (int64_t k = 0; k < f->modes; k++) {
        int64_t at = place_of(k);
        double slope_1 = f->load_slope[k][0], slope_2 = f->load_slope[k][1];
        add_scaled(by[CORNER_1], by[at + LOAD], -slope_1, count);
        add_scaled(by[CORNER_2], by[at + LOAD], -slope_2, count);
        if (k > 0) /* its load is stated where its frequency is */
            add_scaled(by[at], by[at + LOAD], slope_1 + slope_2, count);
    }
}

/* Add coarse points, interpolated, to a row of the exact grid. */
static void add_coarse(const grid *g, const double *coarse, double *row)
{
    for (int64_t i = 0; i < g->exact.length; i++) {
        double fraction = g->fraction[i];
        const double *at = coarse + g->before[i];
        row[i] += (1.0 - fraction) * at[0] + fraction * at[1];
    }
}

/* Density on the grid, aliases included, (n,). */
static void density_on(const family *f, const grid *g, double *out)
{
    double coarse[COARSE_POINTS] = {0.0};
    lane density;
    for (int64_t i = 0; i < g->exact.length; i += BLOCK)
        find_density(f, g->exact.square + i, g->exact.gain + i, (int)least_of(BLOCK, g->exact.length - i), out + i);
    for (int64_t i = 0; i < g->aliases.length; i += COARSE_POINTS) {
        find_density(f, g->aliases.square + i, g->aliases.gain + i, COARSE_POINTS, density);
        add_scaled(coarse, density, 1.0, COARSE_POINTS);
    }
    add_coarse(g, coarse, out);
}

/* Density and derivatives on the grid, (1 + p, n). */
static void gradient_on(const family *f, const grid *g, double *out)
{
    double coarse[1 + MOST_PARAMETERS][COARSE_POINTS] = {{0.0}};
    lane density, by[MOST_PARAMETERS];
    int64_t n = g->exact.length;
    for (int64_t i = 0; i < n; i += BLOCK) {
        int count = (int)least_of(BLOCK, n - i);
        find_gradient(f, g->exact.square + i, g->exact.gain + i, count, out + i, by);
        for (int64_t k = 0; k < f->parameters; k++)
            memcpy(out + (1 + k) * n + i, by[k], (size_t)count * sizeof *out);
    }
    for (int64_t i = 0; i < g->aliases.length; i += COARSE_POINTS) {
        find_gradient(f, g->aliases.square + i, g->aliases.gain + i, COARSE_POINTS, density, by);
        add_scaled(coarse[0], density, 1.0, COARSE_POINTS);
        for (int64_t k = 0; k < f->parameters; k++)
            add_scaled(coarse[1 + k], by[k], 1.0, COARSE_POINTS);
    }
    for (int64_t k = 0; k <= f->parameters; k++)
        add_coarse(g, coarse[k], out + k * n);
}

static bool read_grid(const grid_record *record, grid *g)
{
    bool good = true;
    g->exact = (points){reals(record->square, 1, &good), reals(record->epoch_gain, 1, &good),
                        extent(record->square, 0)};
    g->aliases = (points){reals(record->alias_square, 1, &good), reals(record->alias_gain, 1, &good),
                          extent(record->alias_square, 0)};
    g->before = integers(record->before, 1, &good);
    g->fraction = reals(record->fraction, 1, &good);
    return good && extent(record->epoch_gain, 0) == g->exact.length && extent(record->before, 0) == g->exact.length &&
           extent(record->fraction, 0) == g->exact.length && extent(record->alias_gain, 0) == g->aliases.length &&
           g->aliases.length == ALIAS_ORDERS * COARSE_POINTS;
}

static bool fits_family(int64_t count)
{
    return count >= FIRST_PARAMETERS && count <= MOST_PARAMETERS &&
           (count - FIRST_PARAMETERS) % FURTHER_PARAMETERS == 0;
}

/* Density (1, n), or density and derivatives (1 + p, n), of a family at its log parameters (p,). */
EXPORT int64_t spectrum_density(const array *params_in, const grid_record *record, double reference_hz,
                                const array *rows_out)
{
    bool good = true;
    const double *log_params = reals(params_in, 1, &good);
    double *rows = reals(rows_out, 2, &good);
    grid g;
    family f;
    int64_t count = extent(params_in, 0), rows_wanted = extent(rows_out, 0);
    if (!good || !read_grid(record, &g) || !fits_family(count) || extent(rows_out, 1) != g.exact.length ||
        (rows_wanted != 1 && rows_wanted != 1 + count))
        return BAD_ARRAY;
    describe(log_params, count, reference_hz, &f);
    if (rows_wanted == 1)
        density_on(&f, &g, rows);
    else
        gradient_on(&f, &g, rows);
    return 0;
}

/* A periodogram, the prior and room to compare them in. */
typedef struct {
    const double *power, *weight, *noise, *kernel;
    int64_t bins, kernel_length, stride, low_bins, low_grid;
    grid grid;
    const double *mean, *sigma, *low, *high, *reference_hz;
    const int64_t *first, *end;
    int64_t families, parameters;
    double *density, *rows, *expected, *jacobian, *weighted; /* (g,), (1 + p, g), (b,), (p, b), (b,) */
    double *reduced, *pushed, *tried, *gradient;             /* (p, p), (p,), (p,), (p,) */
} problem;

static bool read_periodogram(const periodogram_record *record, problem *out)
{
    bool good = true;
    out->power = reals(record->power, 1, &good);
    out->weight = reals(record->weight, 1, &good);
    out->noise = reals(record->noise_density, 1, &good);
    out->kernel = reals(record->kernel, 1, &good);
    out->bins = extent(record->power, 0);
    out->kernel_length = extent(record->kernel, 0);
    out->stride = record->stride;
    out->low_bins = record->low_bins;
    out->low_grid = record->low_grid;
    good = good && read_grid(&record->grid, &out->grid);
    int64_t n = out->grid.exact.length, reach = (out->low_bins - 1) * out->stride + out->kernel_length;
    return good && extent(record->weight, 0) == out->bins && extent(record->noise_density, 0) == n &&
           reach <= out->low_grid && n - out->low_grid == out->bins - out->low_bins && out->low_bins <= out->bins;
}

static bool read_prior(const prior_record *record, problem *out)
{
    bool good = true;
    out->mean = reals(record->mean, 1, &good);
    out->sigma = reals(record->sigma, 1, &good);
    out->low = reals(record->low, 1, &good);
    out->high = reals(record->high, 1, &good);
    out->reference_hz = reals(record->reference_hz, 1, &good);
    out->first = integers(record->first, 1, &good);
    out->end = integers(record->end, 1, &good);
    out->families = extent(record->reference_hz, 0);
    int64_t p = out->parameters = extent(record->mean, 0);
    good = good && extent(record->sigma, 0) == p && extent(record->low, 0) == p && extent(record->high, 0) == p &&
           extent(record->first, 0) == out->families && extent(record->end, 0) == out->families;
    for (int64_t k = 0; good && k < out->families; k++)
        good = out->first[k] >= 0 && out->end[k] <= p && fits_family(out->end[k] - out->first[k]);
    return good;
}

/* Arrays of a problem; what to free, or NULL. */
static double *open_problem(const periodogram_record *periodogram, const prior_record *prior, problem *out,
                            int64_t *status)
{
    *status = BAD_ARRAY;
    if (!read_periodogram(periodogram, out) || !read_prior(prior, out))
        return NULL;
    int64_t n = out->grid.exact.length, p = out->parameters, b = out->bins;
    double *room = malloc((size_t)(n + (1 + p) * n + b + p * b + b + p * p + 3 * p + 1) * sizeof *room);
    *status = room ? 0 : NO_MEMORY;
    if (!room)
        return NULL;
    out->density = room;
    out->rows = out->density + n;
    out->expected = out->rows + (1 + p) * n;
    out->jacobian = out->expected + b;
    out->weighted = out->jacobian + p * b;
    out->reduced = out->weighted + b;
    out->pushed = out->reduced + p * p;
    out->tried = out->pushed + p;
    out->gradient = out->tried + p;
    return room;
}

/* Expected periodogram (b,) of a signal of this density (g,). */
static void convolve(const problem *o, const double *density, double *out)
{
    for (int64_t k = 0; k < o->low_bins; k++)
        out[k] = dot(o->kernel, density + k * o->stride, o->kernel_length);
    memcpy(out + o->low_bins, density + o->low_grid, (size_t)(o->bins - o->low_bins) * sizeof *out);
}

static void expect(const problem *o, const double *log_params)
{
    int64_t n = o->grid.exact.length;
    family f;
    memcpy(o->density, o->noise, (size_t)n * sizeof(double));
    for (int64_t k = 0; k < o->families; k++) {
        describe(log_params + o->first[k], o->end[k] - o->first[k], o->reference_hz[k], &f);
        density_on(&f, &o->grid, o->rows);
        add_scaled(o->density, o->rows, 1.0, n);
    }
    convolve(o, o->density, o->expected);
    for (int64_t k = 0; k < o->bins; k++)
        o->expected[k] = o->expected[k] < MIN_EXPECTED ? MIN_EXPECTED : o->expected[k];
}

static double likelihood_cost(const problem *o, const double *log_params)
{
    double total = 0.0;
    expect(o, log_params);
    for (int64_t k = 0; k < o->bins; k++)
        total += o->weight[k] * (log(o->expected[k]) + o->power[k] / o->expected[k]);
    return total;
}

static double posterior_cost(const problem *o, const double *log_params)
{
    double total = 0.0;
    for (int64_t k = 0; k < o->parameters; k++)
        total += squared((log_params[k] - o->mean[k]) / o->sigma[k]);
    return likelihood_cost(o, log_params) + 0.5 * total;
}

/* Gradient (p,) and Fisher information (p, p) of the negative log posterior. */
static void differentiate(const problem *o, const double *log_params, double *gradient, double *information)
{
    int64_t n = o->grid.exact.length, p = o->parameters, b = o->bins;
    family f;
    memcpy(o->density, o->noise, (size_t)n * sizeof(double));
    memset(o->jacobian, 0, (size_t)(p * b) * sizeof(double));
    for (int64_t k = 0; k < o->families; k++) {
        int64_t first = o->first[k], count = o->end[k] - first;
        describe(log_params + first, count, o->reference_hz[k], &f);
        gradient_on(&f, &o->grid, o->rows);
        add_scaled(o->density, o->rows, 1.0, n);
        for (int64_t j = 0; j < count; j++)
            convolve(o, o->rows + (1 + j) * n, o->jacobian + (first + j) * b);
    }
    convolve(o, o->density, o->expected);
    for (int64_t k = 0; k < b; k++) {
        o->expected[k] = o->expected[k] < MIN_EXPECTED ? MIN_EXPECTED : o->expected[k];
        o->weighted[k] = o->weight[k] * (1.0 - o->power[k] / o->expected[k]);
    }
    for (int64_t j = 0; j < p; j++)
        for (int64_t k = 0; k < b; k++)
            o->jacobian[j * b + k] /= o->expected[k];
    for (int64_t j = 0; j < p; j++)
        gradient[j] = dot(o->jacobian + j * b, o->weighted, b) + (log_params[j] - o->mean[j]) / squared(o->sigma[j]);
    for (int64_t j = 0; j < p; j++) {
        for (int64_t k = 0; k < b; k++)
            o->weighted[k] = o->weight[k] * o->jacobian[j * b + k];
        for (int64_t i = 0; i <= j; i++)
            information[j * p + i] = information[i * p + j] = dot(o->weighted, o->jacobian + i * b, b);
        information[j * p + j] += 1.0 / squared(o->sigma[j]);
    }
}

/* One damped step from `log_params` into `tried`; parameters at a bound are held where the step would push them out.
 * False where the information is singular. */
static bool move(const problem *o, const double *log_params, const double *information, double damping)
{
    int64_t p = o->parameters;
    memcpy(o->reduced, information, (size_t)(p * p) * sizeof(double));
    for (int64_t k = 0; k < p; k++) {
        o->pushed[k] = -o->gradient[k];
        o->reduced[k * p + k] *= 1.0 + damping;
    }
    for (int64_t k = 0; k < p; k++) {
        if (!((log_params[k] <= o->low[k] && o->gradient[k] > 0.0) ||
              (log_params[k] >= o->high[k] && o->gradient[k] < 0.0)))
            continue;
        for (int64_t j = 0; j < p; j++)
            o->reduced[k * p + j] = o->reduced[j * p + k] = 0.0;
        o->pushed[k] = 0.0;
        o->reduced[k * p + k] = 1.0;
    }
    if (!solve(o->reduced, o->pushed, p))
        return false;
    for (int64_t k = 0; k < p; k++) {
        double step = least(most(o->pushed[k], -MAX_LOG_STEP), MAX_LOG_STEP);
        o->tried[k] = least(most(log_params[k] + step, o->low[k]), o->high[k]);
    }
    return true;
}

/* Parameters (p,) after at most so many rounds of Fisher scoring, in place, and the information there, (p, p); the
 * negative log posterior. */
static double improve(const problem *o, double *log_params, double *information, int64_t rounds)
{
    double best = posterior_cost(o, log_params), damping = 1e-3;
    int64_t p = o->parameters;
    differentiate(o, log_params, o->gradient, information);
    for (int64_t round = 0; round < rounds; round++) {
        double value = best, promised = INFINITY;
        while (value >= best && promised > CONVERGED && damping < MAX_DAMPING) { /* a step is cheap beside a slope */
            if (!move(o, log_params, information, damping))
                return best;
            promised = 0.0;
            for (int64_t k = 0; k < p; k++)
                promised -= 0.5 * o->gradient[k] * (o->tried[k] - log_params[k]);
            value = posterior_cost(o, o->tried);
            damping = value < best ? 0.2 * damping : most(8.0 * damping, 1e-2);
        }
        if (!(value < best))
            return best;
        bool done = best - value < CONVERGED;
        memcpy(log_params, o->tried, (size_t)p * sizeof *log_params);
        best = value;
        differentiate(o, log_params, o->gradient, information);
        if (done)
            return best;
    }
    return best;
}

/* Expected periodogram (b,) at the parameters (p,). */
EXPORT int64_t whittle_expected(const periodogram_record *periodogram, const prior_record *prior,
                                const array *params_in, const array *expected_out)
{
    bool good = true;
    problem o;
    int64_t status;
    const double *log_params = reals(params_in, 1, &good);
    double *expected = reals(expected_out, 1, &good), *room = open_problem(periodogram, prior, &o, &status);
    if (!room)
        return status;
    good = good && extent(params_in, 0) == o.parameters && extent(expected_out, 0) == o.bins;
    if (good) {
        expect(&o, log_params);
        memcpy(expected, o.expected, (size_t)o.bins * sizeof *expected);
    }
    free(room);
    return good ? 0 : BAD_ARRAY;
}

/* Negative log likelihood and posterior at the parameters (p,), into (2,). */
EXPORT int64_t whittle_cost(const periodogram_record *periodogram, const prior_record *prior, const array *params_in,
                            const array *costs_out)
{
    bool good = true;
    problem o;
    int64_t status;
    const double *log_params = reals(params_in, 1, &good);
    double *costs = reals(costs_out, 1, &good), *room = open_problem(periodogram, prior, &o, &status);
    if (!room)
        return status;
    good = good && extent(params_in, 0) == o.parameters && extent(costs_out, 0) == 2;
    if (good) {
        double pull = 0.0;
        for (int64_t k = 0; k < o.parameters; k++)
            pull += squared((log_params[k] - o.mean[k]) / o.sigma[k]);
        costs[0] = likelihood_cost(&o, log_params);
        costs[1] = costs[0] + 0.5 * pull;
    }
    free(room);
    return good ? 0 : BAD_ARRAY;
}

/* Gradient (p,) and Fisher information (p, p) of the negative log posterior at the parameters (p,). */
EXPORT int64_t whittle_gradient(const periodogram_record *periodogram, const prior_record *prior,
                                const array *params_in, const array *gradient_out, const array *information_out)
{
    bool good = true;
    problem o;
    int64_t status;
    const double *log_params = reals(params_in, 1, &good);
    double *gradient = reals(gradient_out, 1, &good), *information = reals(information_out, 2, &good);
    double *room = open_problem(periodogram, prior, &o, &status);
    if (!room)
        return status;
    int64_t p = o.parameters;
    good = good && extent(params_in, 0) == p && extent(gradient_out, 0) == p && extent(information_out, 0) == p &&
           extent(information_out, 1) == p;
    if (good)
        differentiate(&o, log_params, gradient, information);
    free(room);
    return good ? 0 : BAD_ARRAY;
}

/* Improve the parameters (p,) in place by at most so many rounds; the information there (p, p) and the negative log
 * posterior (1,). */
EXPORT int64_t whittle_improve(const periodogram_record *periodogram, const prior_record *prior,
                               const array *params_in, int64_t rounds, const array *information_out,
                               const array *best_out)
{
    bool good = true;
    problem o;
    int64_t status;
    double *log_params = reals(params_in, 1, &good), *information = reals(information_out, 2, &good);
    double *best = reals(best_out, 1, &good), *room = open_problem(periodogram, prior, &o, &status);
    if (!room)
        return status;
    int64_t p = o.parameters;
    good = good && extent(params_in, 0) == p && extent(information_out, 0) == p && extent(information_out, 1) == p &&
           extent(best_out, 0) == 1;
    if (good)
        *best = improve(&o, log_params, information, rounds);
    free(room);
    return good ? 0 : BAD_ARRAY;
}
