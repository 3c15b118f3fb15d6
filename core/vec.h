#pragma once

#include <cmath>
#include <compare>
#include <cstdint>

namespace sekitei {

/// Three numbers: a point, a direction, a size or an index. World space is right-handed, z up,
/// metres.
template <class T>
struct Vec3 {
    T x{}, y{}, z{};

    constexpr Vec3() = default;
    constexpr explicit Vec3(T all) : x(all), y(all), z(all) {}
    constexpr Vec3(T x_, T y_, T z_) : x(x_), y(y_), z(z_) {}
    template <class U>
    constexpr explicit Vec3(const Vec3<U>& v)
        : x(static_cast<T>(v.x)), y(static_cast<T>(v.y)), z(static_cast<T>(v.z))
    {
    }

    constexpr T& operator[](int axis) { return axis == 0 ? x : axis == 1 ? y : z; }
    constexpr const T& operator[](int axis) const { return axis == 0 ? x : axis == 1 ? y : z; }

    constexpr Vec3& operator+=(Vec3 v) { return *this = *this + v; }
    constexpr Vec3& operator-=(Vec3 v) { return *this = *this - v; }
    constexpr Vec3& operator*=(T s) { return *this = *this * s; }

    friend constexpr Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
    friend constexpr Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
    friend constexpr Vec3 operator-(Vec3 a) { return {-a.x, -a.y, -a.z}; }
    friend constexpr Vec3 operator*(Vec3 a, T s) { return {a.x * s, a.y * s, a.z * s}; }
    friend constexpr Vec3 operator*(T s, Vec3 a) { return a * s; }
    friend constexpr Vec3 operator/(Vec3 a, T s) { return {a.x / s, a.y / s, a.z / s}; }
    friend constexpr bool operator==(const Vec3&, const Vec3&) = default;
    friend constexpr auto operator<=>(const Vec3&,
                                      const Vec3&) = default;  ///< by x, then y, then z
};

using Vec3d = Vec3<double>;
using Vec3f = Vec3<float>;
using Coord = Vec3<std::int32_t>;  ///< a voxel's index

template <class T>
constexpr T dot(Vec3<T> a, Vec3<T> b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

template <class T>
constexpr Vec3<T> cross(Vec3<T> a, Vec3<T> b)
{
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

template <class T>
T length(Vec3<T> a)
{
    return std::sqrt(dot(a, a));
}

/// The unit vector along `a`; the zero vector stays zero.
template <class T>
Vec3<T> normalized(Vec3<T> a)
{
    const T l = length(a);
    return l > 0 ? a / l : a;
}

template <class T>
constexpr Vec3<T> min(Vec3<T> a, Vec3<T> b)
{
    return {a.x < b.x ? a.x : b.x, a.y < b.y ? a.y : b.y, a.z < b.z ? a.z : b.z};
}

template <class T>
constexpr Vec3<T> max(Vec3<T> a, Vec3<T> b)
{
    return {a.x > b.x ? a.x : b.x, a.y > b.y ? a.y : b.y, a.z > b.z ? a.z : b.z};
}

/// A ball [m].
struct Sphere {
    Vec3f centre;
    float radius = 0;
};

/// An axis-aligned box, empty until something is added.
struct Bounds {
    Vec3d lower{INFINITY}, upper{-INFINITY};

    void add(Vec3d p)
    {
        lower = min(lower, p);
        upper = max(upper, p);
    }
    bool empty() const { return !(lower.x <= upper.x); }
    Vec3d size() const { return empty() ? Vec3d{} : upper - lower; }
    Vec3d centre() const { return (lower + upper) * 0.5; }
};

}  // namespace sekitei
