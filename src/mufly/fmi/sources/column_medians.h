/* Medians of columns, equal to those of mufly.sensors.column_medians. */

#ifndef COLUMN_MEDIANS_H
#define COLUMN_MEDIANS_H

static int compare_reals(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Write the median of each column of values, which are stored row by row. */
static void write_column_medians(const double *values, const double *levels, const double (*comparators)[2],
    int64_t rows, double *medians, int64_t columns)
{
    double column[4096]; /* the largest picture of a vehicle file */
    (void)levels;
    (void)comparators;
    for (int64_t k = 0; k < columns; k++) {
        for (int64_t r = 0; r < rows; r++) {
            column[r] = values[r * columns + k];
        }
        qsort(column, (size_t)rows, sizeof column[0], compare_reals);
        medians[k] = 0.5 * (column[(rows - 1) / 2] + column[rows / 2]);
    }
}

#endif
