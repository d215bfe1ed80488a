/* What innovations say of the sources of noise in the rows, step by step: core/tracking/row_noise.py. */
#include <stdlib.h>

#include "linear.h"

/* S^-1 g of a step, (r, s), from the lower half of its covariance (all, all); false where S is not positive definite.
 * `S` and `inverse` are room for two matrices (r, r). */
static bool weigh(const double *covariance, int64_t all, const int64_t *rows, int64_t r, const double *columns,
                  int64_t s, double *S, double *inverse, double *weighted)
{
    for (int64_t i = 0; i < r; i++)
        for (int64_t j = 0; j <= i; j++)
            S[i * r + j] = covariance[most_of(rows[i], rows[j]) * all + least_of(rows[i], rows[j])];
    bool positive = invert_positive(S, r, inverse);
    for (int64_t i = 0; i < r; i++) {
        for (int64_t k = 0; k < s; k++)
            weighted[i * s + k] = 0.0;
        for (int64_t j = 0; j < r; j++)
            add_scaled(weighted + i * s, columns + rows[j] * s, inverse[i * r + j], s);
    }
    return positive;
}

/* Terms of one step, each `spacing` behind the one before: g_k^T S^-1 g_l, (g_k^T S^-1 e)^2, and half the square of its
 * change since the step before. */
static void write_terms(const double *weighted, const double *innovation, const double *before, const int64_t *rows,
                        int64_t r, const double *columns, int64_t s, int64_t spacing, double *out)
{
    double *square = out + s * s * spacing, *half_change = square + s * spacing;
    for (int64_t k = 0; k < s; k++) {
        double score = 0.0, change = 0.0;
        for (int64_t l = 0; l < s; l++) {
            double coupling = 0.0;
            for (int64_t i = 0; i < r; i++)
                coupling += columns[rows[i] * s + k] * weighted[i * s + l];
            out[(k * s + l) * spacing] = coupling;
        }
        for (int64_t i = 0; i < r; i++) {
            score += weighted[i * s + k] * innovation[rows[i]];
            change += weighted[i * s + k] * (innovation[rows[i]] - before[rows[i]]);
        }
        square[k * spacing] = score * score;
        half_change[k * spacing] = 0.5 * (change * change);
    }
}

/* Terms (s s + 2 s, m) of m steps of the innovations (n, all) with covariance (n, all, all), by some rows and the
 * sources' columns (all, s); 0 where a covariance is not positive definite. */
EXPORT int64_t noise_terms(const array *innovation_in, const array *covariance_in, const array *steps_in,
                           const array *rows_in, const array *columns_in, const array *terms_out)
{
    bool good = true;
    const double *innovation = reals(innovation_in, 2, &good), *covariance = reals(covariance_in, 3, &good);
    const double *columns = reals(columns_in, 2, &good);
    const int64_t *steps = integers(steps_in, 1, &good), *rows = integers(rows_in, 1, &good);
    double *terms = reals(terms_out, 2, &good);
    if (!good)
        return BAD_ARRAY;
    int64_t n = extent(innovation_in, 0), all = extent(innovation_in, 1), m = extent(steps_in, 0);
    int64_t r = extent(rows_in, 0), s = extent(columns_in, 1);
    if (extent(covariance_in, 0) != n || extent(covariance_in, 1) != all || extent(covariance_in, 2) != all ||
        extent(columns_in, 0) != all || extent(terms_out, 0) != s * s + 2 * s || extent(terms_out, 1) != m ||
        !all_within(steps, m, 1, n) || !all_within(rows, r, 0, all))
        return BAD_ARRAY;
    double *S = malloc((size_t)(2 * r * r + r * s + 1) * sizeof *S);
    if (!S)
        return NO_MEMORY;
    double *inverse = S + r * r, *weighted = inverse + r * r;
    bool positive = true;
    for (int64_t k = 0; k < m; k++) {
        const double *now = innovation + steps[k] * all;
        positive &= weigh(covariance + steps[k] * all * all, all, rows, r, columns, s, S, inverse, weighted);
        write_terms(weighted, now, now - all, rows, r, columns, s, m, terms + k);
    }
    free(S);
    return positive;
}
