"""The same work in plain C, compiled locally if gcc is available. It shows the speed that careful programming can
reach.
"""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

SOURCE = r"""
#include <stdint.h>
#include <math.h>
#define M9(n, p) double n##0=p[0],n##1=p[1],n##2=p[2],n##3=p[3],n##4=p[4],n##5=p[5],n##6=p[6],n##7=p[7],n##8=p[8]
#define ROW(n, i, j, k, a, b, c) (n##i*a + n##j*b + n##k*c)

void matrices(const double *restrict x, const double *restrict y, double *restrict w, double *restrict a,
              const double *m, const double *o, const double *n, const double *p, const double *g, int64_t count) {
  M9(m, m); M9(n, n); M9(g, g);
  double o0=o[0],o1=o[1],o2=o[2],p0=p[0],p1=p[1],p2=p[2];
  for (int64_t k = 0; k < 3 * count; k += 3) {
    double y0=y[k]-p0, y1=y[k+1]-p1, y2=y[k+2]-p2;
    double a0=ROW(n,0,1,2,y0,y1,y2), a1=ROW(n,3,4,5,y0,y1,y2), a2=ROW(n,6,7,8,y0,y1,y2);
    a[k]=a0; a[k+1]=a1; a[k+2]=a2;
    double x0=x[k]-o0, x1=x[k+1]-o1, x2=x[k+2]-o2;
    w[k]=ROW(m,0,1,2,x0,x1,x2)-ROW(g,0,1,2,a0,a1,a2);
    w[k+1]=ROW(m,3,4,5,x0,x1,x2)-ROW(g,3,4,5,a0,a1,a2);
    w[k+2]=ROW(m,6,7,8,x0,x1,x2)-ROW(g,6,7,8,a0,a1,a2);
  }
}

/* the bytes alone, by the stores of a loop that computes, where a library's copy may take other instructions */
__attribute__((optimize("no-tree-loop-distribute-patterns")))
void copies(const double *restrict x, const double *restrict y, double *restrict w, double *restrict a, int64_t count) {
  for (int64_t k = 0; k < 3 * count; k++) { w[k] = x[k]; a[k] = y[k]; }
}

static inline int64_t cell(double x, double start, double inverse, int64_t cells, double *f) {
  double p = (x - start) * inverse, last = cells - 1, low = p > 0 ? p : 0;
  int64_t i = (int64_t)(low < last ? low : last);
  double r = p - i;
  r = r < 0 ? 0 : r;
  *f = r > 1 ? 1 : r;
  return i;
}

/* s: per temperature cell 6 x (value, slope); e: per temperature and rate cell 3 x (4 coefficients) */
void tables(const double *restrict x, const double *restrict y, const double *restrict t, double *restrict w,
            double *restrict a, const double *m, const double *n, const double *g, const double *restrict s,
            const double *restrict e, double t0, double ti, int64_t tc, double r0, double ri, int64_t rc, int64_t count) {
  M9(m, m); M9(n, n); M9(g, g);
  for (int64_t k = 0; k < count; k++) {
    double f, r;
    int64_t i = cell(t[k], t0, ti, tc, &f), q = 3 * k;
    const double *c = s + 12 * i;
    double y0=y[q]-(c[6]+f*c[7]), y1=y[q+1]-(c[8]+f*c[9]), y2=y[q+2]-(c[10]+f*c[11]);
    double a0=ROW(n,0,1,2,y0,y1,y2), a1=ROW(n,3,4,5,y0,y1,y2), a2=ROW(n,6,7,8,y0,y1,y2);
    a[q]=a0; a[q+1]=a1; a[q+2]=a2;
    double x0=x[q]-(c[0]+f*c[1]), x1=x[q+1]-(c[2]+f*c[3]), x2=x[q+2]-(c[4]+f*c[5]);
    double v[3] = {ROW(m,0,1,2,x0,x1,x2)-ROW(g,0,1,2,a0,a1,a2), ROW(m,3,4,5,x0,x1,x2)-ROW(g,3,4,5,a0,a1,a2),
                   ROW(m,6,7,8,x0,x1,x2)-ROW(g,6,7,8,a0,a1,a2)};
    for (int axis = 0; axis < 3; axis++) {
      int64_t j = cell(v[axis], r0, ri, rc, &r);
      const double *d = e + 12 * (i * rc + j) + 4 * axis;
      w[q + axis] = v[axis] - (d[0] + f*d[1] + r*(d[2] + f*d[3]));
    }
  }
}

void strapdown(const double *restrict g, const double *restrict t, const double *q0, double *restrict out, int64_t n) {
  double w=q0[0], x=q0[1], y=q0[2], z=q0[3];
  out[0]=w; out[1]=x; out[2]=y; out[3]=z;
  for (int64_t k = 1; k < n; k++) {
    double h = 0.5*(t[k]-t[k-1]), a=g[3*k]*h, b=g[3*k+1]*h, c=g[3*k+2]*h, u=a*a+b*b+c*c, s, v;
    if (u < 0.01) {
      s = 1 - u*(1/6. - u*(1/120. - u*(1/5040. - u/362880.)));
      v = 1 - u*(0.5 - u*(1/24. - u*(1/720. - u/40320.)));
    } else { double l = sqrt(u); s = sin(l)/l; v = cos(l); }
    a*=s; b*=s; c*=s;
    double nw=w*v-x*a-y*b-z*c, nx=w*a+x*v+y*c-z*b, ny=w*b-x*c+y*v+z*a, nz=w*c+x*b-y*a+z*v;
    double l = 1.5 - 0.5*(nw*nw+nx*nx+ny*ny+nz*nz);
    w=nw*l; x=nx*l; y=ny*l; z=nz*l;
    out[4*k]=w; out[4*k+1]=x; out[4*k+2]=y; out[4*k+3]=z;
  }
}

void biquad(const double *restrict x, double *restrict y, double b0, double b1, double b2, double a1, double a2, int64_t n) {
  double s[3]={0,0,0}, r[3]={0,0,0};
  for (int64_t k = 0; k < n; k++) for (int c = 0; c < 3; c++) {
    double v = x[3*k+c], u = b0*v + s[c];
    s[c] = b1*v - a1*u + r[c];
    r[c] = b2*v - a2*u;
    y[3*k+c] = u;
  }
}
"""


def compiled() -> ctypes.CDLL | None:
    """Compile the rivals.

    Returns
    -------
    CDLL or None
        None where there is no gcc.
    """
    if shutil.which("gcc") is None:
        return None
    folder = Path(tempfile.mkdtemp(prefix="undrift-bench-"))
    (folder / "rival.c").write_text(SOURCE)
    flags = ["-O3", "-march=native", "-ffp-contract=fast", "-shared", "-fPIC"]
    subprocess.run(["gcc", *flags, "rival.c", "-o", "rival.so", "-lm"], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "rival.so"))
    shutil.rmtree(folder)
    return library


def pointer(x: np.ndarray) -> ctypes.c_void_p:
    """Return the address of an array.

    Parameters
    ----------
    x : array
        Contiguous float64.

    Returns
    -------
    c_void_p
        Its first element.
    """
    return ctypes.c_void_p(x.ctypes.data)
