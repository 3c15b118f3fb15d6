#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/mesh.h"
#include "core/progress.h"

/// Binary glTF 2.0 as a stream: what it holds is announced, then written block by block.
namespace sekitei::gltf {

/// z up becomes y up.
inline Vec3f y_up(Vec3f v)
{
    return {v.x, v.z, -v.y};
}

/// The name of a custom attribute: an underscore and capitals. The owning column has the name other
/// programs know it by, _COLUMN_ID.
std::string semantic(const std::string& name);

/// Lowest and highest value of each component.
using Range = std::pair<std::vector<double>, std::vector<double>>;

/// A file in the making.
class File {
public:
    /// What bytes are for: other programs send the first two to the graphics card as they are.
    enum class Use { Vertices, Indices, Copies };
    /// Puts the components of elements [begin, end) one after the other; called on many threads.
    using Fill = std::function<void(std::size_t begin, std::size_t end, float* to)>;

    /// Announces an accessor over `count` elements of 1 to 4 floats each; returns its number.
    /// @param name  for messages
    /// @param fill  what it holds must outlive write()
    int floats(std::size_t count, int components, Use use, const std::string& name, Fill fill,
               const std::optional<Range>& range = {});
    int indices(std::shared_ptr<const std::vector<std::uint32_t>> values);

    /// Writes `document`, to which it adds accessors and buffers, and all values. Values that are
    /// not finite become 0 or the largest float, with a warning.
    /// @throws LimitExceeded  more than 4.29 GB
    void write(nlohmann::json document, const std::function<void(std::string_view)>& sink,
               const Progress& progress) const;

private:
    struct Accessor {
        std::size_t count = 0;
        int components = 1;
        Use use = Use::Vertices;
        std::string name;
        Fill fill;
        std::shared_ptr<const std::vector<std::uint32_t>> indices;
        std::optional<Range> range;

        std::uint64_t bytes() const { return 4ull * count * std::uint64_t(components); }
    };
    std::vector<Accessor> accessors_;
};

/// Numbers at the vertices of a mesh, besides its attributes.
using VertexField = std::pair<std::string, const std::vector<float>*>;

/// Announces a mesh: POSITION, NORMAL, COLOR_0, TEXCOORD_0 and custom attributes in the world with
/// y up. Vertices are split where an int32 face attribute or the texture changes; other face
/// attributes become the mean of the faces around a vertex. What is called the same on vertices and
/// on faces is the faces' where it is an identity, else the vertices'.
/// @param mesh     must outlive the file, like the fields
/// @param normals  whether it gets normals where it has none: the mean over the triangles around a
///                 vertex, weighted by area
/// @return a primitive, without material
/// @throws InvalidInput  two attributes of one name
nlohmann::json add_primitive(File& file, const TriMesh& mesh,
                             const std::vector<VertexField>& fields, bool normals,
                             const Progress& progress);

}  // namespace sekitei::gltf
