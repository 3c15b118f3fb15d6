#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "core/error.h"
#include "core/mesh_io.h"

/// Any bytes are a mesh or InvalidInput; what was read can be inspected, written and read again.
/// The first byte chooses the name, and so the reader of bytes that tell nothing.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
{
    using namespace sekitei;
    if (size == 0) return 0;
    static constexpr const char* kNames[] = {"a.ply", "a.obj", "a.off", "a.stl", "a"};
    const std::string_view bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
    MeshReadReport report;
    TriMesh mesh;
    try {
        mesh = decode_mesh(bytes, kNames[data[0] % 5], &report);
    } catch (const InvalidInput&) {
        return 0;
    } catch (const LimitExceeded&) {
        return 0;
    }
    const MeshReport seen = inspect(mesh);
    if (seen.triangles == 0 || seen.bad_vertices > 0 || seen.zero_area > 0) std::abort();
    std::string ply;
    try {
        ply = encode_mesh(mesh, ".ply");
    } catch (const InvalidInput&) {
        return 0;  // two attributes of one name
    }
    const TriMesh again = decode_mesh(ply, "again.ply", &report);
    if (again.triangles.size() != mesh.triangles.size()) std::abort();
    return 0;
}
