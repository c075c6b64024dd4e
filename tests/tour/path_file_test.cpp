#include "iris/tour/path_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::tour {
namespace {
namespace fs = std::filesystem;
using ::testing::HasSubstr;

class PathFile : public ::testing::Test {
 protected:
  fs::path write(const std::string& text) {
    write_file(file_, text);
    return file_;
  }
  std::string problem_of(const std::string& text) {
    try {
      read_camera_path_file(write(text));
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  }
  void TearDown() override { fs::remove(file_); }

  fs::path file_ = fs::temp_directory_path() / ("iris_path_" + std::to_string(getpid()) + ".json");
};

// Camera at (1, 2, 3): nerfstudio's axes in the world: x = (0, 1, 0), y = (0, 0, 1), z = (1, 0, 0), so it looks along
// -x.
const std::string kEntry = R"({"camera_to_world": [0,0,1,1, 1,0,0,2, 0,1,0,3, 0,0,0,1], "fov": 60})";

std::string file_with(const std::string& entries, const std::string& more = R"("seconds": 2,)") {
  return "{" + more + R"("render_width": 320, "render_height": 200, "camera_path": [)" + entries + "]}";
}

TEST_F(PathFile, AxesTimesAndFieldOfView) {
  const CameraPathFile file =
      read_camera_path_file(write(file_with(kEntry + "," + kEntry + "," + kEntry + "," + kEntry)));
  EXPECT_EQ(file.width, 320);
  EXPECT_EQ(file.height, 200);
  EXPECT_EQ(file.projection, Projection::pinhole);
  ASSERT_EQ(file.path.keyframes.size(), 4u);
  for (size_t i = 0; i < 4; ++i) EXPECT_NEAR(file.path.keyframes[i].t, 0.5 * static_cast<double>(i), 1e-12);
  const CameraKeyframe& key = file.path.keyframes[0];
  EXPECT_NEAR(key.fov, M_PI / 3, 1e-12);
  EXPECT_TRUE(key.world_from_cam.translation().isApprox(Eigen::Vector3d(1, 2, 3)));
  EXPECT_TRUE((key.world_from_cam.linear() * Eigen::Vector3d::UnitZ()).isApprox(Eigen::Vector3d(-1, 0, 0)));  // sight
  EXPECT_TRUE((key.world_from_cam.linear() * Eigen::Vector3d::UnitY()).isApprox(Eigen::Vector3d(0, 0, -1)));  // down
  EXPECT_NEAR(key.world_from_cam.linear().determinant(), 1, 1e-12);
}

TEST_F(PathFile, FramesPerSecondReplaceSecondsAndPanoramasNeedNoFov) {
  const std::string entry = R"({"camera_to_world": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]})";
  const CameraPathFile file =
      read_camera_path_file(write(file_with(entry + "," + entry, R"("fps": 24, "camera_type": "equirectangular",)")));
  EXPECT_EQ(file.projection, Projection::equirectangular);
  EXPECT_NEAR(file.path.keyframes[1].t, 1.0 / 24, 1e-12);
}

TEST_F(PathFile, KeyframesSayWhereAndWhitherInSeveralWays) {
  const CameraPathFile file = read_camera_path_file(write(R"({
    "width": 320, "height": 200, "fps": 25, "fov": 40, "ease": 0.5, "comment": "a hall", "keyframes": [
      {"t": 1, "position": [1, 2, 1.5], "look_at": [1, 5, 1.5], "caption": "Hall"},
      {"t": 3, "position": [1, 3, 1.5], "yaw": 90},
      {"t": 4, "position": [1, 3, 1.5], "quaternion": [-0.5, 0.5, -0.5, 0.5], "fov": 60, "caption": ""},
      {"t": 6, "position": [1, 3, 1.5], "yaw": 180, "pitch": 30, "roll": 20}]})"));
  EXPECT_EQ(file.width, 320);
  EXPECT_EQ(file.fps, 25);
  EXPECT_EQ(file.path.ease, 0.5);
  EXPECT_EQ(file.path.interpolation, CameraPath::Interpolation::spline);
  ASSERT_EQ(file.path.keyframes.size(), 4u);
  const auto axis = [&](size_t i, int a) {
    return Eigen::Vector3d(file.path.keyframes[i].world_from_cam.linear().col(a));
  };
  EXPECT_LT((axis(0, 2) - Eigen::Vector3d(0, 1, 0)).norm(), 1e-12);
  EXPECT_LT((axis(0, 1) - Eigen::Vector3d(0, 0, -1)).norm(), 1e-12);
  EXPECT_TRUE(file.path.keyframes[1].world_from_cam.linear().isApprox(file.path.keyframes[0].world_from_cam.linear()));
  // z up from a level camera: forward is x, right is -y.
  EXPECT_LT((axis(2, 2) - Eigen::Vector3d(1, 0, 0)).norm(), 1e-12);
  EXPECT_LT((axis(2, 0) - Eigen::Vector3d(0, -1, 0)).norm(), 1e-12);
  EXPECT_LT((axis(3, 2) - Eigen::Vector3d(-std::cos(M_PI / 6), 0, 0.5)).norm(), 1e-12);
  EXPECT_NEAR(axis(3, 0).z(), -std::sin(20 * M_PI / 180) * std::cos(M_PI / 6), 1e-12);  // clockwise: right goes down
  EXPECT_NEAR(file.path.keyframes[0].fov, 40 * M_PI / 180, 1e-12);
  EXPECT_NEAR(file.path.keyframes[2].fov, M_PI / 3, 1e-12);
  EXPECT_EQ(file.path.keyframes[3].t, 6);
  ASSERT_EQ(file.captions.size(), 2u);
  EXPECT_EQ(file.captions[0].text, "Hall");
  EXPECT_EQ(file.captions[0].t, 1);
  EXPECT_EQ(file.captions[1].t, 4);
}

TEST_F(PathFile, KeyframesWithoutTimesAreFlownAtTheSpeedOfAWalk) {
  const std::string keys = R"("keyframes": [{"position": [0, 0, 1]}, {"position": [4, 0, 1]},
                              {"position": [4, 0, 1], "yaw": 90}], "interpolation": "linear"})";
  TourOptions options;
  options.walk_speed = 0.5;
  options.turn_rate = 30;
  const CameraPathFile file = read_camera_path_file(write("{" + keys), options);
  EXPECT_NEAR(file.path.keyframes[1].t, 8, 1e-9);
  EXPECT_NEAR(file.path.keyframes[2].t, 11, 1e-9);
  EXPECT_EQ(file.path.interpolation, CameraPath::Interpolation::linear);
  EXPECT_NEAR(read_camera_path_file(write("{\"seconds\": 22, " + keys), options).path.keyframes[1].t, 16, 1e-9);
  options.seconds = 5.5;
  EXPECT_NEAR(read_camera_path_file(write("{\"seconds\": 22, " + keys), options).path.keyframes[1].t, 4, 1e-9);
  // One look is held.
  EXPECT_NEAR(duration(read_camera_path_file(write(R"({"keyframes": [{"position": [0, 0, 1]}]})"), options).path), 5.5,
              1e-12);
}

TEST_F(PathFile, MistakesInKeyframesAreNamed) {
  const auto keys = [&](const std::string& entries) { return problem_of("{\"keyframes\": [" + entries + "]}"); };
  EXPECT_THAT(keys(""), HasSubstr("no entries in \"keyframes\""));
  EXPECT_THAT(keys("{}"), HasSubstr("keyframes[0] has no \"position\""));
  EXPECT_THAT(keys(R"({"position": [1, 2]})"), HasSubstr("not [x, y, z]"));
  EXPECT_THAT(keys(R"({"position": [1, 2, 3], "yaw": 1, "look_at": [0, 0, 0]})"), HasSubstr("more than one"));
  EXPECT_THAT(keys(R"({"position": [1, 2, 3], "look_at": [1, 2, 3]})"), HasSubstr("own position"));
  EXPECT_THAT(keys(R"({"position": [1, 2, 3], "yow": 1})"), HasSubstr("unknown key \"yow\""));
  EXPECT_THAT(keys(R"({"position": [1, 2, 3], "quaternion": [1, 1, 0, 0]})"), HasSubstr("length 1"));
  EXPECT_THAT(keys(R"({"position": [1, 2, 3], "pitch": 90})"), HasSubstr("pitch"));
  EXPECT_THAT(keys(R"({"position": [1, 2, 3], "fov": 200})"), HasSubstr("fov"));
  EXPECT_THAT(keys(R"({"position": [1, 2, 3], "t": 1}, {"position": [1, 2, 3]})"), HasSubstr("others not"));
  EXPECT_THAT(keys(R"({"position": [1, 2, 3], "t": 1}, {"position": [1, 2, 3], "t": 1})"),
              HasSubstr("does not ascend"));
  EXPECT_THAT(problem_of(R"({"keyframes": [{"position": [1, 2, 3]}], "interpolation": "cubic"})"),
              HasSubstr("neither spline nor linear"));
  EXPECT_THAT(problem_of(R"({"keyframes": [{"position": [1, 2, 3]}], "width": 100})"), HasSubstr("only one of"));
}

TEST_F(PathFile, MistakesAreNamed) {
  EXPECT_THAT(problem_of("{\"camera_path\": ["), HasSubstr("is not a JSON object"));
  EXPECT_THAT(problem_of("[]"), HasSubstr("is not a JSON object"));
  EXPECT_THAT(problem_of("{}"), HasSubstr("camera_path"));
  EXPECT_THAT(problem_of(file_with("")), HasSubstr("no entries"));
  EXPECT_THAT(problem_of(file_with(kEntry, "")), HasSubstr("neither \"seconds\" nor \"fps\""));
  EXPECT_THAT(problem_of(file_with(kEntry, R"("seconds": -1,)")), HasSubstr("\"seconds\" is not positive"));
  EXPECT_THAT(problem_of(file_with(kEntry, R"("seconds": "2",)")), HasSubstr("\"seconds\" is not a number"));
  EXPECT_THAT(problem_of(file_with(kEntry, R"("seconds": 1, "camera_type": "fisheye",)")), HasSubstr("camera_type"));
  EXPECT_THAT(problem_of(file_with(kEntry + R"(, {"fov": 50})")),
              HasSubstr("camera_path[1] has no \"camera_to_world\""));
  EXPECT_THAT(problem_of(file_with(R"({"camera_to_world": [1,2,3], "fov": 50})")),
              HasSubstr("3 numbers instead of 16"));
  EXPECT_THAT(problem_of(file_with(R"({"camera_to_world": 5, "fov": 50})")), HasSubstr("camera_path[0]"));
  EXPECT_THAT(problem_of(file_with(R"({"camera_to_world": [1,0,0,0,0,2,0,0,0,0,1,0,0,0,0,1], "fov": 50})")),
              HasSubstr("not a rotation"));
  EXPECT_THAT(problem_of(file_with(R"({"camera_to_world": [1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]})")), HasSubstr("\"fov\""));
  EXPECT_THAT(problem_of(file_with(R"({"camera_to_world": [1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1], "fov": 190})")),
              HasSubstr("below 180"));
  EXPECT_THAT(problem_of(file_with("7")), HasSubstr("camera_path[0]"));
  EXPECT_THROW(read_camera_path_file("/nowhere/path.json"), InputError);
}

}  // namespace
}  // namespace iris::tour
