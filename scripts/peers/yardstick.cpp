// The term-project report's algorithm, written straight: a grid of lists of indices, filled anew in each frame, and for
// each disc all discs of the nine cells around it, so that each pair is tested in both orders.
//
// Compiled with -O3 -march=native -fopenmp by with_cpp.py, and called through ctypes.

#include <algorithm>
#include <cmath>
#include <vector>

namespace {

using Real = float;

struct Disc {
    Real x, y, vx, vy;
};

class Gas {
public:
    Gas(int count, double width, double height, double radius, const double *position, const double *velocity)
        : width_(Real(width)), height_(Real(height)), radius_(Real(radius)),
          columns_(std::max(1, int(width / (2 * radius)))), rows_(std::max(1, int(height / (2 * radius)))),
          discs_(count), cells_(size_t(columns_) * rows_) {
        for (int i = 0; i < count; ++i)
            discs_[i] = {Real(position[2 * i]), Real(position[2 * i + 1]), Real(velocity[2 * i]),
                         Real(velocity[2 * i + 1])};
    }

    // walls: impulses on the left, right, lower and upper wall, to which this adds; null: they are not counted.
    void run(double dt, int frames, int threads, double *walls) {
        for (int frame = 0; frame < frames; ++frame) {
            if (walls)
                move<true>(Real(dt), 1, walls);
            else
                move<false>(Real(dt), threads, walls);
            fill();
            // Unguarded, as in the report: two threads may change one disc at the same time.
#pragma omp parallel for schedule(static) num_threads(threads) if (threads > 1)
            for (int column = 0; column < columns_; ++column)
                resolve(column);
        }
    }

    void read(double *position, double *velocity) const {
        for (size_t i = 0; i < discs_.size(); ++i) {
            position[2 * i] = discs_[i].x;
            position[2 * i + 1] = discs_[i].y;
            velocity[2 * i] = discs_[i].vx;
            velocity[2 * i + 1] = discs_[i].vy;
        }
    }

private:
    template <bool Counting>
    static void reflect(Real &place, Real &speed, Real low, Real high, double *walls) {
        if (place < low) {
            place = low;
            if (speed < 0) {
                speed = -speed;
                if (Counting)
                    walls[0] += 2.0 * speed;
            }
        } else if (place > high) {
            place = high;
            if (speed > 0) {
                if (Counting)
                    walls[1] += 2.0 * speed;
                speed = -speed;
            }
        }
    }

    template <bool Counting>
    void move(Real dt, int threads, double *walls) {
        const int count = int(discs_.size());
#pragma omp parallel for schedule(static) num_threads(threads) if (threads > 1)
        for (int i = 0; i < count; ++i) {
            Disc &disc = discs_[i];
            disc.x += disc.vx * dt;
            disc.y += disc.vy * dt;
            reflect<Counting>(disc.x, disc.vx, radius_, width_ - radius_, walls);
            reflect<Counting>(disc.y, disc.vy, radius_, height_ - radius_, walls ? walls + 2 : nullptr);
        }
    }

    void fill() {
        for (std::vector<int> &cell : cells_)
            cell.clear();
        const Real x_scale = columns_ / width_, y_scale = rows_ / height_;
        for (size_t i = 0; i < discs_.size(); ++i) {
            const int column = std::clamp(int(discs_[i].x * x_scale), 0, columns_ - 1);
            const int row = std::clamp(int(discs_[i].y * y_scale), 0, rows_ - 1);
            cells_[size_t(column) * rows_ + row].push_back(int(i));
        }
    }

    void resolve(int column) {
        for (int row = 0; row < rows_; ++row)
            for (int a : cells_[size_t(column) * rows_ + row])
                for (int c = std::max(column - 1, 0); c <= std::min(column + 1, columns_ - 1); ++c)
                    for (int r = std::max(row - 1, 0); r <= std::min(row + 1, rows_ - 1); ++r)
                        for (int b : cells_[size_t(c) * rows_ + r])
                            if (a != b)
                                collide(discs_[a], discs_[b]);
    }

    void collide(Disc &a, Disc &b) const {
        const Real x = b.x - a.x, y = b.y - a.y, diameter = 2 * radius_, square = x * x + y * y;
        if (square >= diameter * diameter || square == 0)
            return;
        const Real distance = std::sqrt(square), nx = x / distance, ny = y / distance;
        const Real half = (diameter - distance) / 2;
        a.x -= nx * half;
        a.y -= ny * half;
        b.x += nx * half;
        b.y += ny * half;
        const Real approach = (b.vx - a.vx) * nx + (b.vy - a.vy) * ny;
        if (approach >= 0)
            return;
        a.vx += approach * nx;
        a.vy += approach * ny;
        b.vx -= approach * nx;
        b.vy -= approach * ny;
    }

    Real width_, height_, radius_;
    int columns_, rows_;
    std::vector<Disc> discs_;
    std::vector<std::vector<int>> cells_;
};

}  // namespace

extern "C" void *yardstick_new(int count, double width, double height, double radius, const double *position,
                               const double *velocity) {
    return new Gas(count, width, height, radius, position, velocity);
}
extern "C" void yardstick_run(Gas *gas, double dt, int frames, int threads, double *walls) {
    gas->run(dt, frames, threads, walls);
}
extern "C" void yardstick_read(Gas *gas, double *position, double *velocity) { gas->read(position, velocity); }
extern "C" void yardstick_free(Gas *gas) { delete gas; }
