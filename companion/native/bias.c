/* What is learned of the bias parameters (core/tracking/bias_information.py has the equations): their information ages,
 * and is solved for them and their covariance. */
#include <stdlib.h>
#include <string.h>

#include "linear.h"

/* Age one column: its noise is marginalised, the state's dependence on it becomes its own variance. */
static void age_column(double *information, double *x, double *covariance, int64_t n, int64_t width, int64_t column,
                       double noise, double autocorrelation, double *scratch)
{
    double *learned = scratch, *sensitivity = scratch + width;
    memcpy(learned, information + column * width, (size_t)width * sizeof *learned);
    for (int64_t i = 0; i < n; i++)
        sensitivity[i] = x[i * width + column];
    double gain = noise / (1.0 + noise * learned[column]);
    for (int64_t i = 0; i < n; i++) {
        for (int64_t j = 0; j < width; j++)
            x[i * width + j] -= gain * (sensitivity[i] * learned[j]);
        for (int64_t j = 0; j < n; j++)
            covariance[i * n + j] += gain * (sensitivity[i] * sensitivity[j]);
        x[i * width + column] *= autocorrelation;
    }
    for (int64_t i = 0; i < width; i++)
        for (int64_t j = 0; j < width; j++)
            information[i * width + j] -= gain * (learned[i] * learned[j]);
    for (int64_t j = 0; j < width; j++)
        information[column * width + j] *= autocorrelation;
    for (int64_t i = 0; i < width; i++)
        information[i * width + column] *= autocorrelation;
}

/* Age the information (width, width) of the wandering columns, with [x | V] (n + 1, width) and P (n, n), in place. */
EXPORT int64_t bias_age(const array *information_in, const array *x_in, const array *covariance_in,
                        const array *wandering_in, const array *sigma_in, double autocorrelation)
{
    bool good = true;
    double *information = reals(information_in, 2, &good), *x = reals(x_in, 2, &good);
    double *covariance = reals(covariance_in, 2, &good);
    const double *sigma = reals(sigma_in, 1, &good);
    const int64_t *wandering = integers(wandering_in, 1, &good);
    if (!good)
        return BAD_ARRAY;
    int64_t width = extent(information_in, 0), n = extent(covariance_in, 0), columns = extent(wandering_in, 0);
    if (extent(information_in, 1) != width || extent(x_in, 0) != n + 1 || extent(x_in, 1) != width ||
        extent(covariance_in, 1) != n || extent(sigma_in, 0) != width - 1 || !all_within(wandering, columns, 1, width))
        return BAD_ARRAY;
    double *scratch = malloc((size_t)(width + n) * sizeof *scratch);
    if (!scratch)
        return NO_MEMORY;
    for (int64_t k = 0; k < columns; k++) {
        double noise = (1.0 - autocorrelation * autocorrelation) * squared(sigma[wandering[k] - 1]);
        age_column(information, x, covariance, n, width, wandering[k], noise, autocorrelation, scratch);
    }
    free(scratch);
    return 0;
}

/* The estimated parameters, whose covariance is P (e, e), and what the considered ones add to it (Schmidt). `map` and
 * `gain`, (e, k), are room for P times the information between both kinds, and this by the priors' variances. */
static void spread(const double *information, const double *sigma, const int64_t *estimated, int64_t e,
                   const int64_t *considered, int64_t k, int64_t c, const double *P, double *map, double *gain,
                   double *parameters, double *covariance)
{
    int64_t width = c + 1;
    for (int64_t i = 0; i < e; i++) {
        double total = 0.0;
        for (int64_t j = 0; j < k; j++)
            map[i * k + j] = 0.0;
        for (int64_t m = 0; m < e; m++) {
            const double *row = information + (estimated[m] + 1) * width;
            total += P[i * e + m] * row[0];
            for (int64_t j = 0; j < k; j++)
                map[i * k + j] -= P[i * e + m] * row[considered[j] + 1];
        }
        parameters[estimated[i]] = -total;
        for (int64_t j = 0; j < k; j++)
            gain[i * k + j] = map[i * k + j] * squared(sigma[considered[j]]);
    }
    for (int64_t i = 0; i < e; i++) {
        for (int64_t m = 0; m <= i; m++)
            covariance[estimated[i] * c + estimated[m]] = covariance[estimated[m] * c + estimated[i]] =
                P[i * e + m] + dot(gain + i * k, map + m * k, k);
        for (int64_t j = 0; j < k; j++)
            covariance[estimated[i] * c + considered[j]] = covariance[considered[j] * c + estimated[i]] =
                gain[i * k + j];
    }
}

/* Solve the information (1 + c, 1 + c) with the priors' sigma (c,) for the parameters (c,) and their covariance (c, c),
 * in place; not a number where the information has run away. */
EXPORT int64_t bias_solve(const array *information_in, const array *sigma_in, const array *estimated_in,
                          const array *considered_in, const array *parameters_out, const array *covariance_out)
{
    bool good = true;
    const double *information = reals(information_in, 2, &good), *sigma = reals(sigma_in, 1, &good);
    const int64_t *estimated = integers(estimated_in, 1, &good), *considered = integers(considered_in, 1, &good);
    double *parameters = reals(parameters_out, 1, &good), *covariance = reals(covariance_out, 2, &good);
    if (!good)
        return BAD_ARRAY;
    int64_t c = extent(sigma_in, 0), e = extent(estimated_in, 0), k = extent(considered_in, 0);
    if (extent(information_in, 0) != c + 1 || extent(information_in, 1) != c + 1 || extent(parameters_out, 0) != c ||
        extent(covariance_out, 0) != c || extent(covariance_out, 1) != c || !all_within(estimated, e, 0, c) ||
        !all_within(considered, k, 0, c))
        return BAD_ARRAY;
    double *factor = malloc((size_t)(2 * e * e + 2 * e * k + 1) * sizeof *factor);
    if (!factor)
        return NO_MEMORY;
    double *P = factor + e * e, *map = P + e * e;
    for (int64_t i = 0; i < e; i++) {
        for (int64_t j = 0; j < e; j++)
            factor[i * e + j] = information[(estimated[i] + 1) * (c + 1) + estimated[j] + 1];
        factor[i * e + i] += 1.0 / squared(sigma[estimated[i]]);
    }
    invert_positive(factor, e, P);
    spread(information, sigma, estimated, e, considered, k, c, P, map, map + e * k, parameters, covariance);
    free(factor);
    return 0;
}
