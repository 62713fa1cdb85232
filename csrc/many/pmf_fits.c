/* Check whether numbers can be a configuration of this build.
 * SPDX-License-Identifier: Apache-2.0
 *
 * Python fills the structure and passes it as a whole. Every number of turns and every index is compared here to the
 * available memory, whatever program filled the structure. An exported configuration has passed the check. */
#include "pmf_many.h"

enum { NODES = PMF_SIGNALS + PMF_MAX_STAGES };

static uint32_t network_fits(const pmf_network_config_t *network)
{
    uint32_t i, tap = 0U, fits = 1U;
    if (network->n_stages > PMF_MAX_STAGES || network->n_columns > PMF_MAX_COLUMNS ||
        network->n_rates > PMF_MAX_RATES) {
        return 0U;
    }
    for (i = 0; i < network->n_stages; ++i) {
        fits &= network->stage[i].source < NODES &&
                        (network->stage[i].rate == 0U || network->stage[i].rate < network->n_rates)
                    ? 1U
                    : 0U;
    }
    for (i = 0; i < network->n_columns; ++i) {
        fits &= network->tap_end[i] >= tap && network->tap_end[i] <= PMF_MAX_TAPS ? 1U : 0U;
        tap = network->tap_end[i];
    }
    for (i = 0; i < tap && fits != 0U; ++i) {
        fits &= network->tap[i].node < NODES ? 1U : 0U;
    }
    return fits;
}

/* Regressors, target and instruments from column `first`. */
static uint32_t columns_fit(uint32_t first, uint32_t parameters, uint32_t instrumental)
{
    return parameters <= PMF_MAX_PARAMETERS && first < PMF_MAX_COLUMNS && instrumental <= 1U &&
                   first + (1U + instrumental) * parameters < PMF_MAX_COLUMNS
               ? 1U
               : 0U;
}

/* The constant and the coefficient of its lift exist together or not at all. */
static uint32_t level_fits(const pmf_recursion_config_t *recursion)
{
    uint32_t none = recursion->constant == PMF_NO_PARAMETER && recursion->lowest == PMF_NO_PARAMETER;
    return none != 0U || recursion->n_parameters == 0U ||
                   (recursion->constant < recursion->n_parameters && recursion->lowest < recursion->n_parameters &&
                    recursion->constant != recursion->lowest)
               ? 1U
               : 0U;
}

/* The errors from misread counts follow all other columns. */
static uint32_t misread_fits(const pmf_recursion_config_t *recursion)
{
    uint32_t i,
        fits = recursion->n_misread <= PMF_MAX_PARAMETERS && recursion->misread_column < PMF_MAX_COLUMNS &&
                       recursion->first_column + recursion->misread_column < PMF_MAX_COLUMNS - recursion->n_misread
                   ? 1U
                   : 0U;
    for (i = 0; i < recursion->n_misread && fits != 0U; ++i) {
        fits &= recursion->misread_index[i] < PMF_MAX_PARAMETERS ? 1U : 0U;
    }
    return fits;
}

static uint32_t recursion_fits(const pmf_recursion_config_t *recursion)
{
    return columns_fit(recursion->first_column, recursion->n_parameters, recursion->instrumental) != 0U &&
                   recursion->leading < PMF_MAX_PARAMETERS && level_fits(recursion) != 0U &&
                   misread_fits(recursion) != 0U
               ? 1U
               : 0U;
}

static uint32_t is_parameter(uint32_t index)
{
    return index < PMF_MAX_PARAMETERS || index == PMF_NO_PARAMETER ? 1U : 0U;
}

/* Return whether a signal may be written to a node. Valid are no node and the nodes after those of encoder and body. */
static uint32_t may_be_written(uint32_t node)
{
    return node == 0U || (node >= PMF_SIGNALS && node < NODES) ? 1U : 0U;
}

uint32_t pmf_shapes_fit(const pmf_shapes_config_t *shapes)
{
    uint32_t i, fits = shapes->n <= PMF_MAX_SHAPES ? 1U : 0U;
    for (i = 0; i < shapes->n && fits != 0U; ++i) {
        const pmf_shape_t *shape = &shapes->shape[i];
        fits &= shape->of <= PMF_OF_WAVE && shape->intervals >= 1U && shape->intervals < PMF_MAX_KNOTS &&
                        shape->first < PMF_MAX_KNOTS - shape->intervals
                    ? 1U
                    : 0U;
        fits &= may_be_written(shape->node) & may_be_written(shape->measured);
    }
    return fits;
}

static uint32_t auxiliary_fits(const pmf_auxiliary_config_t *model)
{
    uint32_t role, i,
        fits = model->target_column < PMF_MAX_COLUMNS && model->mass_column < PMF_MAX_COLUMNS &&
                       model->check_column < PMF_MAX_COLUMNS - 2U && model->sensitivities <= PMF_ROLES
                   ? 1U
                   : 0U;
    for (role = 0; role < PMF_ROLES && model->adapt != 0U; ++role) {
        fits &= is_parameter(model->index[role]) & is_parameter(model->direct_index[role]);
    }
    for (i = 0; i < model->sensitivities && fits != 0U; ++i) {
        fits &= model->cause[i] < NODES && model->role[i] < PMF_ROLES ? 1U : 0U;
    }
    for (i = 0; i < model->shapes.n && i < PMF_MAX_SHAPES; ++i) {
        fits &= model->shapes.shape[i].node != 0U ? 1U : 0U;
    }
    return fits;
}

uint32_t pmf_fits(const pmf_config_t *config)
{
    return (config->late.kept <= PMF_MAX_LATE && config->late.kept != 1U ? 1U : 0U) & network_fits(&config->network) &
           recursion_fits(&config->direct) & recursion_fits(&config->instrument) &
           pmf_shapes_fit(&config->auxiliary.shapes) &
           (config->auxiliary.enabled == 0U ? 1U : auxiliary_fits(&config->auxiliary));
}
