/* What no program can go below: one sine and one cosine per joint. */
#include <math.h>

void run(const double *q, const double *alpha, long count, double *out)
{
  for (long k = 0; k < count * N; ++k) {
    out[2 * k] = cos(q[k]);
    out[2 * k + 1] = sin(q[k]);
  }
}
