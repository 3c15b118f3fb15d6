#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/mesh.h"
#include "core/progress.h"

namespace sekitei::render {

/// Where a ray meets something.
struct SurfacePoint {
    Vec3f position, normal;      ///< world [m]; smooth normal towards the viewer
    std::uint32_t triangle = 0;  ///< not for the ground
    float u = 0, v = 0;          ///< weights of its second and third corner
    float footprint = 0;         ///< size of the pixel here [m]: finer detail is left out
    bool seen = true;            ///< by the camera; indirect light needs no detail
};

/// What it is made of there: matt with a rough shine [Walter2007].
struct Material {
    Vec3f albedo{0.5f};
    Vec3f normal;          ///< with relief
    float roughness = 1;   ///< square root of GGX alpha
    float specular = 0;    ///< 0: matt only; 1: reflects 4 % head on
    Vec3f transmit{0.0f};  ///< albedo of a thin leaf for light from behind; zero: opaque
    Vec3f glow{0.0f};      ///< light of its own, for the camera alone
};

/// Materials for a mesh and the ground under it.
class Look {
public:
    virtual ~Look() = default;
    virtual Material surface(const SurfacePoint& point) const = 0;
    virtual Material ground(const SurfacePoint& point) const = 0;
};

/// One colour everywhere.
class PlainLook : public Look {
public:
    PlainLook(Vec3f albedo, Vec3f ground) : albedo_(albedo), ground_(ground) {}
    Material surface(const SurfacePoint& p) const override { return {albedo_, p.normal, 1, 0}; }
    Material ground(const SurfacePoint& p) const override { return {ground_, p.normal, 1, 0}; }

private:
    Vec3f albedo_, ground_;
};

/// Colours given for each triangle corner or each triangle.
class ColourLook : public Look {
public:
    /// @param colours       one a vertex (interpolated), or one a triangle
    /// @param first_bright  triangles from here on shine by themselves and scatter nothing; theirs
    ///                      are colours of triangles
    ColourLook(const TriMesh& mesh, std::vector<Vec3f> colours, bool per_vertex, Vec3f ground,
               std::size_t first_bright = SIZE_MAX)
        : mesh_(mesh),
          colours_(std::move(colours)),
          per_vertex_(per_vertex),
          ground_(ground),
          first_bright_(first_bright)
    {
    }
    Material surface(const SurfacePoint& p) const override;
    Material ground(const SurfacePoint& p) const override { return {ground_, p.normal, 1, 0}; }

private:
    const TriMesh& mesh_;
    std::vector<Vec3f> colours_;
    bool per_vertex_;
    Vec3f ground_;
    std::size_t first_bright_;
};

/// Basalt. `column` gives each column a colour, shine and grain of its own, `surface` its history
/// (0 joint wall, weathered grey-brown; 1 cut face, fresh blue-grey; 2 cooling contact, oxidised
/// crust; 3 slow contact; 4 terrain, with lichen; 5 edge of the domain, plain;
/// 6 soil; 7 dressed granite). Attributes may be
/// of vertices or triangles, or missing. Detail below the mesh's size is gradient noise in world
/// space, in units of the column width found from the mesh; striae run across each column's axis,
/// which is the direction its wall normals share least.
class RockLook : public Look {
public:
    RockLook(const TriMesh& mesh, std::uint64_t seed, const Progress& progress = {});

    Material surface(const SurfacePoint& point) const override;
    Material ground(const SurfacePoint& point) const override;

    /// Whether some of it is soil.
    bool has_soil() const { return has_soil_; }
    double column_width() const { return static_cast<double>(width_); }  ///< [m]

private:
    struct Column {
        Vec3f axis{0, 0, 1}, shift;
        float value = 1, warmth = 0, roughness = 0, pitch = 0;
    };
    struct Where {
        std::uint32_t column = 0;  // slot
        int surface = 0;
        float joint = 0;  // nearness to a joint without a gap, 0..1
    };
    Where where(const SurfacePoint& point) const;
    void find_columns(std::uint64_t seed, const Progress& progress);
    void measure_columns(const Progress& progress);
    void find_joints(const Progress& progress);

    const TriMesh& mesh_;
    std::uint32_t key_;
    float width_ = 1;
    std::vector<Column> columns_;       // slot 0: no column known
    std::vector<std::uint32_t> slots_;  // of triangles or vertices
    std::vector<float> joint_;          // of vertices: 1 where triangles of different columns meet
    bool slots_per_face_ = true;
    const std::vector<std::int32_t>* surface_ = nullptr;
    bool surface_per_face_ = true, has_soil_ = false;
};

}  // namespace sekitei::render
