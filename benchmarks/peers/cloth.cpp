// The linearised implicit step of one cloth and its derivative by all stiffnesses, by hand for vector registers of four
// doubles: what a C++ programmer would ship who knows the method and the machine. Compiled and called by cpp_peer.py.
//
// A is kept as its upper half, 3 x 3 blocks of three padded columns; conjugate gradients with SSOR in Eisenstat's form,
// from the polynomial through the last six solutions. Springs and faces are worked on in lanes, four at a time.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <vector>

typedef double v4 __attribute__((vector_size(32)));
typedef long i4 __attribute__((vector_size(32)));

namespace {

const int TERMS = 6, BATCH = 64;

struct Block { v4 x, y, z; };  // columns

template <class T> struct Array {  // zeroed and aligned
    T* a; size_t size;
    explicit Array(size_t count) : a(static_cast<T*>(aligned_alloc(64, (count * sizeof(T) + 63) / 64 * 64))), size(count) { clear(); }
    ~Array() { free(a); }
    Array(const Array&) = delete;
    void clear() { memset(static_cast<void*>(a), 0, size * sizeof(T)); }
    T& operator[](size_t i) { return a[i]; }
};

inline v4 quad(const double* a) { return v4{a[0], a[1], a[2], a[3]}; }
inline v4 all(double s) { return v4{s, s, s, s}; }
inline v4 lane0(v4 a) { return __builtin_shuffle(a, i4{0, 0, 0, 0}); }
inline v4 lane1(v4 a) { return __builtin_shuffle(a, i4{1, 1, 1, 1}); }
inline v4 lane2(v4 a) { return __builtin_shuffle(a, i4{2, 2, 2, 2}); }
inline double sum3(v4 a) { return a[0] + a[1] + a[2]; }
inline v4 times(const Block& b, v4 x, v4 total) {
    total += b.x * lane0(x);
    total += b.y * lane1(x);
    return total + b.z * lane2(x);
}
inline void transpose(v4 a, v4 b, v4 c, v4 d, v4& x, v4& y, v4& z) {
    v4 ab0 = __builtin_shuffle(a, b, i4{0, 4, 2, 6}), ab1 = __builtin_shuffle(a, b, i4{1, 5, 3, 7});
    v4 cd0 = __builtin_shuffle(c, d, i4{0, 4, 2, 6}), cd1 = __builtin_shuffle(c, d, i4{1, 5, 3, 7});
    x = __builtin_shuffle(ab0, cd0, i4{0, 1, 4, 5});
    y = __builtin_shuffle(ab1, cd1, i4{0, 1, 4, 5});
    z = __builtin_shuffle(ab0, cd0, i4{2, 3, 6, 7});
}
inline void back(v4 x, v4 y, v4 z, v4& a, v4& b, v4& c, v4& d) {  // lane 3 becomes 0
    v4 o = all(0.0);
    v4 xy0 = __builtin_shuffle(x, y, i4{0, 4, 2, 6}), xy1 = __builtin_shuffle(x, y, i4{1, 5, 3, 7});
    v4 zo0 = __builtin_shuffle(z, o, i4{0, 4, 2, 6}), zo1 = __builtin_shuffle(z, o, i4{1, 5, 3, 7});
    a = __builtin_shuffle(xy0, zo0, i4{0, 1, 4, 5});
    b = __builtin_shuffle(xy1, zo1, i4{0, 1, 4, 5});
    c = __builtin_shuffle(xy0, zo0, i4{2, 3, 6, 7});
    d = __builtin_shuffle(xy1, zo1, i4{2, 3, 6, 7});
}
inline v4 root(v4 a) {
    v4 r;
    for (int l = 0; l < 4; l++) r[l] = std::sqrt(a[l]);
    return r;
}

}  // namespace

extern "C" struct Cloth {
    long n, springs, faces, rows, slots;
    const double *x0, *v0, *mass, *rest;        // (n, 4), (n, 4), (n,), (springs padded to four,)
    const int *ends, *corners, *isfree;         // (springs padded, 2), (faces, 3), (n,)
    const int *order, *row, *column, *slot;     // (rows,), (rows + 1,), (slots,), (springs padded,)
    double drag, damping, h, wind[4], gravity[4];
};

namespace {

struct Work {
    Array<Block> D, inverse, U;
    Array<v4> b, x, r, p, t, q, z, own, past;
    explicit Work(const Cloth& c)
        : D(c.n), inverse(c.n), U(c.slots + 1), b(c.n), x(c.n), r(c.n), p(c.n), t(c.n), q(c.n), z(c.n), own(c.n),
          past(TERMS * c.n) {}
};

void assemble(const Cloth& c, const double* k, const v4* x, const v4* v, bool right, Work& w) {
    const double h = c.h;
    w.U.clear();
    const v4 weight = h * quad(c.gravity);
    for (long i = 0; i < c.n; i++) {
        double m = c.mass[i], d = m * (1.0 + h * c.damping);
        w.D[i] = Block{v4{d, 0, 0, 0}, v4{0, d, 0, 0}, v4{0, 0, d, 0}};
        w.b[i] = m * (v[i] + weight);
    }
    for (long s = 0; s < c.springs; s += 4) {
        const int* e = c.ends + 2 * s;
        v4 a, b, d, ex, ey, ez, f[4];
        transpose(x[e[0]] - x[e[1]], x[e[2]] - x[e[3]], x[e[4]] - x[e[5]], x[e[6]] - x[e[7]], ex, ey, ez);
        v4 length = root(ex * ex + ey * ey + ez * ez), rest = *(const v4*)(c.rest + s), stiff;
        memcpy(&stiff, k + s, sizeof stiff);
        v4 inverse = 1.0 / length, rho = rest * inverse;
        v4 across = h * h * stiff * (1.0 - rho), along = h * stiff * (h * rho + 0.5 * c.damping);
        v4 pull = h * stiff * (length - rest);
        ex *= inverse, ey *= inverse, ez *= inverse;
        back(ex, ey, ez, f[0], f[1], f[2], f[3]);
        for (int l = 0; l < 4; l++) {
            int i = e[2 * l], j = e[2 * l + 1];
            v4 dir = f[l], out = along[l] * dir;
            double t = across[l];
            Block B{out * lane0(dir) + v4{t, 0, 0, 0}, out * lane1(dir) + v4{0, t, 0, 0}, out * lane2(dir) + v4{0, 0, t, 0}};
            Block &P = w.D[i], &Q = w.D[j], &R = w.U[c.slot[s + l]];
            P.x += B.x, P.y += B.y, P.z += B.z;
            Q.x += B.x, Q.y += B.y, Q.z += B.z;
            R.x -= B.x, R.y -= B.y, R.z -= B.z;
            if (right) {
                v4 g = pull[l] * dir;
                w.b[i] -= g, w.b[j] += g;
            }
        }
        (void)a, (void)b, (void)d;
    }
    const v4 wind = quad(c.wind);
    for (long f = 0; f < c.faces; f++) {
        const int* q = c.corners + 3 * f;
        v4 p1 = x[q[1]] - x[q[0]], p2 = x[q[2]] - x[q[0]];
        v4 n = __builtin_shuffle(p1, i4{1, 2, 0, 3}) * __builtin_shuffle(p2, i4{2, 0, 1, 3}) -
               __builtin_shuffle(p1, i4{2, 0, 1, 3}) * __builtin_shuffle(p2, i4{1, 2, 0, 3});
        double kappa = h * c.drag / 6.0 * std::sqrt(sum3(n * n));
        v4 mean = (v[q[0]] + v[q[1]] + v[q[2]]) * (1.0 / 3.0);
        double inflow = sum3(n * (wind - mean));
        v4 kn = kappa * n;
        Block B{kn * lane0(n), kn * lane1(n), kn * lane2(n)};
        for (int l = 0; l < 3; l++) {
            Block& P = w.D[q[l]];
            P.x += B.x, P.y += B.y, P.z += B.z;
            if (right) w.b[q[l]] += kn * (inflow + sum3(n * v[q[l]]));
        }
    }
}

void invert(const Cloth& c, double scale, Work& w) {
    for (long r = 0; r < c.rows; r++) {
        int i = c.order[r];
        const Block& d = w.D[i];
        double a = d.x[0], b = d.x[1], e = d.x[2], f = d.y[1], g = d.y[2], k = d.z[2];
        double c0 = f * k - g * g, c1 = e * g - b * k, c2 = b * g - e * f;
        double s = scale / (a * c0 + b * c1 + e * c2);
        double yz = (b * e - a * g) * s;
        w.inverse[i] = Block{v4{c0 * s, c1 * s, c2 * s, 0}, v4{c1 * s, (a * k - e * e) * s, yz, 0}, v4{c2 * s, yz, (a * f - b * b) * s, 0}};
    }
}

// Solve A y = b from the guess in y; returns the iterations.
int solve(const Cloth& c, double tolerance, v4* y, Work& w) {
    const int *order = c.order, *row = c.row, *column = c.column;
    v4 *x = w.x.a, *r = w.r.a, *p = w.p.a, *t = w.t.a, *q = w.q.a, *z = w.z.a, *own = w.own.a;
    Block *D = w.D.a, *U = w.U.a, *inverse = w.inverse.a;
    v4 bb = all(0), rr4 = all(0);
    for (long k = 0; k < c.rows; k++) {
        int i = order[k];
        bb += w.b[i] * w.b[i];
        own[i] = w.b[i];
        x[i] = y[i];
    }
    for (long k = 0; k < c.rows; k++) {
        int i = order[k];
        v4 xi = -x[i], total = times(D[i], xi, own[i]);
        for (int e = row[k]; e < row[k + 1]; e++) {
            int j = column[e];
            total = times(U[e], -x[j], total);
            own[j] = times(U[e], xi, own[j]);
        }
        r[i] = total;
        rr4 += total * total;
    }
    double rr = sum3(rr4), target = tolerance * tolerance * sum3(bb);
    if (rr <= target) return 0;
    v4 low = all(0), high = all(0);
    double diagonal = 0, off = 0;
    for (long k = 0; k < c.rows; k++) {
        Block& d = D[order[k]];
        diagonal += d.x[0] + d.y[1] + d.z[2];
    }
    for (long e = 0; e < c.slots; e++) off += U[e].x[0] + U[e].y[1] + U[e].z[2];
    (void)low, (void)high;
    double ratio_ = std::min(std::max(1.0 + 2.0 * off / diagonal, 1e-5), 1.0);
    double omega = 2.0 / (1.0 + std::pow(ratio_, 0.2)), scale = 1.0 / omega, kappa = 2.0 / omega - 1.0;
    invert(c, omega, w);
    v4 sum = all(0);
    for (long k = 0; k < c.rows; k++) {
        int i = order[k];
        v4 s = times(inverse[i], r[i], all(0));
        v4 minus = -s;
        for (int e = row[k]; e < row[k + 1]; e++) r[column[e]] = times(U[e], minus, r[column[e]]);
        r[i] = s;
        z[i] = times(D[i], scale * s, all(0));
        sum += s * z[i];
    }
    double rz = sum3(sum), ratio = rr / rz, beta = 0;
    for (int iteration = 1; iteration < 100000; iteration++) {
        for (long k = c.rows - 1; k >= 0; k--) {
            int i = order[k];
            v4 pi = z[i] + beta * p[i], total = all(0);
            p[i] = pi;
            for (int e = row[k + 1] - 1; e >= row[k]; e--) total = times(U[e], t[column[e]], total);
            v4 ti = times(inverse[i], pi - total, all(0));
            t[i] = ti;
            own[i] = times(D[i], -kappa * ti, pi);
        }
        v4 curvature = all(0);
        for (long k = 0; k < c.rows; k++) {
            int i = order[k];
            v4 s = times(inverse[i], own[i], all(0)), minus = -s;
            q[i] = t[i] + s;
            curvature += p[i] * q[i];
            for (int e = row[k]; e < row[k + 1]; e++) own[column[e]] = times(U[e], minus, own[column[e]]);
        }
        double alpha = rz / sum3(curvature);
        sum = all(0);
        for (long k = 0; k < c.rows; k++) {
            int i = order[k];
            x[i] += alpha * t[i];
            v4 ri = r[i] - alpha * q[i];
            r[i] = ri;
            v4 zi = times(D[i], scale * ri, all(0));
            z[i] = zi;
            sum += ri * zi;
        }
        double rz_new = sum3(sum);
        if (rz_new * ratio <= 4.0 * target) {
            w.own.clear();
            v4 total = all(0);
            for (long k = 0; k < c.rows; k++) {
                int i = order[k];
                v4 s = times(D[i], scale * r[i], own[i]);
                total += s * s;
                for (int e = row[k]; e < row[k + 1]; e++) own[column[e]] = times(U[e], r[i], own[column[e]]);
            }
            rr = sum3(total);
            if (rr <= target) {
                for (long k = 0; k < c.rows; k++) y[order[k]] = x[order[k]];
                return iteration;
            }
            ratio = rr / rz_new;
        }
        beta = rz_new / rz, rz = rz_new;
    }
    return -1;
}

// Take the newest solution from y and replace it by a guess of the next; `count` solutions were found so far.
void guess(long n, long count, v4* past, v4* y) {
    if (count == 0) { memset(static_cast<void*>(y), 0, n * sizeof *y); return; }
    v4 sizes[TERMS + 1];
    for (v4& s : sizes) s = all(0);
    for (long i = 0; i < n; i++) {
        v4 fresh = y[i];
        for (int k = 0; k < TERMS; k++) {
            sizes[k] += fresh * fresh;
            v4 old = past[i * TERMS + k];
            past[i * TERMS + k] = fresh;
            fresh -= old;
        }
        sizes[TERMS] += fresh * fresh;
    }
    long known = std::min<long>(count - 1, TERMS), best = 1;
    double least = INFINITY;
    for (long k = 1; k <= known; k++)
        if (sum3(sizes[k]) < least) best = k, least = sum3(sizes[k]);
    long terms = best >= known && count <= TERMS ? count : best;
    for (long i = 0; i < n; i++) {
        v4 total = past[i * TERMS];
        for (long k = 1; k < terms; k++) total += past[i * TERMS + k];
        y[i] = total;
    }
}

long march(const Cloth& c, const double* k, long steps, double tolerance, v4* xs, v4* vs, Work& w) {
    long n = c.n, iterations = 0;
    memcpy(static_cast<void*>(xs), c.x0, n * sizeof *xs);
    memcpy(static_cast<void*>(vs), c.v0, n * sizeof *vs);
    Array<v4> y(n);
    for (long s = 0; s < steps; s++) {
        v4 *x = xs + s * n, *v = vs + s * n;
        assemble(c, k, x, v, true, w);
        guess(n, s, w.past.a, y.a);
        iterations += solve(c, tolerance, y.a, w);
        for (long i = 0; i < n; i++) {
            v[n + i] = y[i];
            x[n + i] = x[i] + c.h * y[i];
        }
    }
    return iterations;
}

void springs_back(const Cloth& c, const double* k, const v4* x, const v4* w, const v4* lam, v4* x_bar, double* gradient) {
    const double h = c.h;
    for (long s = 0; s < c.springs; s += 4) {
        const int* e = c.ends + 2 * s;
        v4 ex, ey, ez, wx, wy, wz, lx, ly, lz, stiff, grad;
        transpose(x[e[0]] - x[e[1]], x[e[2]] - x[e[3]], x[e[4]] - x[e[5]], x[e[6]] - x[e[7]], ex, ey, ez);
        transpose(w[e[0]] - w[e[1]], w[e[2]] - w[e[3]], w[e[4]] - w[e[5]], w[e[6]] - w[e[7]], wx, wy, wz);
        transpose(lam[e[0]] - lam[e[1]], lam[e[2]] - lam[e[3]], lam[e[4]] - lam[e[5]], lam[e[6]] - lam[e[7]], lx, ly, lz);
        memcpy(&stiff, k + s, sizeof stiff);
        memcpy(&grad, gradient + s, sizeof grad);
        v4 inverse = 1.0 / root(ex * ex + ey * ey + ez * ez);
        v4 dx = ex * inverse, dy = ey * inverse, dz = ez * inverse;
        v4 rho = *(const v4*)(c.rest + s) * inverse, sigma = h * rho + 0.5 * c.damping;
        v4 ld = lx * dx + ly * dy + lz * dz, wd = wx * dx + wy * dy + wz * dz;
        v4 lev = lx * (ex + h * wx) + ly * (ey + h * wy) + lz * (ez + h * wz);
        grad -= h * ((1.0 - rho) * lev + sigma * ld * wd);
        memcpy(gradient + s, &grad, sizeof grad);
        v4 hk = -h * stiff;
        v4 cl = hk * ((1.0 - rho) + sigma * wd * inverse), cw = hk * sigma * ld * inverse;
        v4 cd = hk * (rho * lev - (h * rho + 2.0 * sigma) * ld * wd) * inverse, f[4];
        // the change of e + h w with e is part of cl's own: (1 - rho) l, and of cw's: h (1 - rho) 0
        back(cl * lx + cw * wx + cd * dx, cl * ly + cw * wy + cd * dy, cl * lz + cw * wz + cd * dz, f[0], f[1], f[2], f[3]);
        for (int l = 0; l < 4; l++) x_bar[e[2 * l]] += f[l], x_bar[e[2 * l + 1]] -= f[l];
    }
}

inline v4 cross(v4 a, v4 b) {
    return __builtin_shuffle(a, i4{1, 2, 0, 3}) * __builtin_shuffle(b, i4{2, 0, 1, 3}) -
           __builtin_shuffle(a, i4{2, 0, 1, 3}) * __builtin_shuffle(b, i4{1, 2, 0, 3});
}

void faces_back(const Cloth& c, const v4* x, const v4* v, const v4* w, const v4* lam, v4* x_bar, v4* v_bar) {
    const v4 wind = quad(c.wind);
    for (long f = 0; f < c.faces; f++) {
        const int* q = c.corners + 3 * f;
        v4 p1 = x[q[1]] - x[q[0]], p2 = x[q[2]] - x[q[0]], n = cross(p1, p2);
        double size = sum3(n * n);
        if (size == 0.0) continue;
        double hk = c.h * c.drag / 6.0 * std::sqrt(size), total = 0, value = 0;
        v4 relative = wind - (v[q[0]] + v[q[1]] + v[q[2]]) * (1.0 / 3.0), g = all(0);
        double inflow = sum3(n * relative);
        for (int l = 0; l < 3; l++) {
            int m = q[l];
            v4 change = w[m] - v[m];
            double nu = sum3(lam[m] * n), theta = sum3(change * n);
            total += nu;
            value += nu * theta;
            g += lam[m] * (theta - inflow) + change * nu;
            v_bar[m] += hk * nu * n;
        }
        value -= total * inflow;
        g = -hk * (g - relative * total + value / size * n);
        v4 air = hk * total / 3.0 * n;
        v_bar[q[0]] -= air, v_bar[q[1]] -= air, v_bar[q[2]] -= air;
        v4 by_p = cross(p2, g), by_q = cross(g, p1);
        x_bar[q[1]] += by_p;
        x_bar[q[2]] += by_q;
        x_bar[q[0]] -= by_p + by_q;
    }
}

}  // namespace

extern "C" long simulate(const Cloth* c, const double* k, long steps, double tolerance, double* xs, double* vs) {
    Work w(*c);
    return march(*c, k, steps, tolerance, reinterpret_cast<v4*>(xs), reinterpret_cast<v4*>(vs), w);
}

// The cost against target (steps + 1, n, 4) and its gradient (springs padded,), which is 0 before.
extern "C" double cost_and_gradient(const Cloth* c, const double* k, long steps, double tolerance, const double* target, double* gradient) {
    long n = c->n;
    Work w(*c);
    Array<v4> xs((steps + 1) * n), vs((steps + 1) * n), lam(n), x_bar(n), v_bar(n);
    march(*c, k, steps, tolerance, xs.a, vs.a, w);
    const v4* goal = reinterpret_cast<const v4*>(target);
    v4 cost = all(0);
    for (long t = steps; t >= 0; t--) {
        for (long i = 0; i < n; i++) {
            v4 gap = xs[t * n + i] - goal[t * n + i];
            cost += gap * gap;
            x_bar[i] += 2.0 * gap;
        }
        if (t == 0) break;
        v4 *x = xs.a + (t - 1) * n, *v = vs.a + (t - 1) * n, *next = vs.a + t * n;
        assemble(*c, k, x, v, false, w);
        for (long i = 0; i < n; i++) w.b[i] = c->isfree[i] ? v_bar[i] + c->h * x_bar[i] : all(0);
        guess(n, steps - t, w.past.a, lam.a);
        solve(*c, tolerance, lam.a, w);
        for (long i = 0; i < n; i++) v_bar[i] = c->mass[i] * lam[i];
        springs_back(*c, k, x, next, lam.a, x_bar.a, gradient);
        faces_back(*c, x, v, next, lam.a, x_bar.a, v_bar.a);
    }
    return sum3(cost);
}
