/* The sequential measurement update of starwise.kernels.update in C: a floor for the time, and a check of the result.

   Same operations in the same order as `update_sequential` for moving receivers (states: position 0..2, velocity
   3..5, the rest anywhere). P is n x n, row by row. Compiled by the benchmark only; no part of the package. */
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { NONE = 0, CODE = 1, RATE = 2, BOTH = 3, MAX_STATES = 256 };

static int satellite(double *restrict x, double *restrict P, int n, int ic, int idr, const double *u, const double *g,
                     double v1, double v2, double r1, double r2, double gate1, double gate2, double *nis, double *s_out)
{
    double a[MAX_STATES], b[MAX_STATES];
    const double ux = u[0], uy = u[1], uz = u[2], gx = g[0], gy = g[1], gz = g[2];
    for (int i = 0; i < n; i++) {
        a[i] = P[ic * n + i] - ux * P[i] - uy * P[n + i] - uz * P[2 * n + i];
        b[i] = P[idr * n + i] + gx * P[i] + gy * P[n + i] + gz * P[2 * n + i] - ux * P[3 * n + i] - uy * P[4 * n + i]
               - uz * P[5 * n + i];
    }
    double s21 = -ux * a[3] - uy * a[4] - uz * a[5] + a[idr] + gx * a[0] + gy * a[1] + gz * a[2];
    double s22 = r2 - ux * b[3] - uy * b[4] - uz * b[5] + b[idr] + gx * b[0] + gy * b[1] + gz * b[2];
    double s11 = a[ic] - ux * a[0] - uy * a[1] - uz * a[2] + r1;
    double m11 = 1.0 / s11, m21 = 0.0, m22 = 0.0, y1 = m11 * v1, y2 = 0.0;
    int used = CODE;
    *nis = y1 * v1;
    if (r2 < INFINITY) {
        double det = s11 * s22 - s21 * s21;
        m11 = s22 / det, m21 = -s21 / det, m22 = s11 / det;
        y1 = m11 * v1 + m21 * v2, y2 = m21 * v1 + m22 * v2;
        *nis = v1 * y1 + v2 * y2;
        used = BOTH;
        if (!(det > 0.0 && s11 > 0.0 && *nis <= gate2)) {
            y1 = m11 = m21 = 0.0, m22 = 1.0 / s22, y2 = m22 * v2, *nis = y2 * v2, used = RATE;
            if (!(s22 > 0.0 && *nis <= gate1))
                y2 = m22 = 0.0, m11 = 1.0 / s11, y1 = m11 * v1, *nis = y1 * v1, used = CODE;
        }
    } else
        s22 = NAN;
    s_out[0] = s11, s_out[1] = s22;
    if (used == CODE && !(s11 > 0.0 && *nis <= gate1)) {
        *nis = 0.0;
        return NONE;
    }
    for (int i = 0; i < n; i++) {
        x[i] += a[i] * y1 + b[i] * y2;
        double ka = m11 * a[i] + m21 * b[i], kb = m21 * a[i] + m22 * b[i];
        for (int j = 0; j < n; j++) P[i * n + j] -= ka * a[j] + kb * b[j];
    }
    return used;
}

double update(double *restrict x, double *restrict P, int n, const int64_t *ic, const int64_t *idr, const double *u,
              const double *g, const double *v, const double *r, int m, double gate1, double gate2, double *v_out,
              double *s_out, uint8_t *used)
{
    double sum = 0.0;
    for (int k = 0; k < m; k++) {
        const double *uk = u + 3 * k, *gk = g + 3 * k;
        double v1 = v[2 * k] - (x[ic[k]] - uk[0] * x[0] - uk[1] * x[1] - uk[2] * x[2]);
        double v2 = v[2 * k + 1] - (x[idr[k]] + gk[0] * x[0] + gk[1] * x[1] + gk[2] * x[2])
                    + (uk[0] * x[3] + uk[1] * x[4] + uk[2] * x[5]);
        double nis;
        used[k] = (uint8_t)satellite(x, P, n, (int)ic[k], (int)idr[k], uk, gk, v1, v2, r[2 * k], r[2 * k + 1], gate1,
                                     gate2, &nis, s_out + 2 * k);
        v_out[2 * k] = v1, v_out[2 * k + 1] = r[2 * k + 1] < INFINITY ? v2 : NAN;
        sum += nis;
    }
    for (int i = 1; i < n; i++)
        for (int j = 0; j < i; j++) P[j * n + i] = P[i * n + j];
    return sum;
}

void turns(long k, double *restrict x, double *restrict P, const double *P0, int n, const int64_t *ic,
           const int64_t *idr, const double *u, const double *g, const double *v, const double *r, int m, double gate1,
           double gate2, double *v_out, double *s_out, uint8_t *used)
{
    for (; k > 0; k--) {
        memset(x, 0, (size_t)n * sizeof *x);
        memcpy(P, P0, (size_t)n * n * sizeof *P);
        update(x, P, n, ic, idr, u, g, v, r, m, gate1, gate2, v_out, s_out, used);
    }
}
