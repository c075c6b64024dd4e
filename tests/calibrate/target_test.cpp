#include "iris/calibrate/target.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iris/core/error.h"

namespace iris::calibrate {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

TEST(Target, TextsAreUnderstood) {
  const Target squares = parse_target("squares:7x5:20mm");
  EXPECT_EQ(squares.kind, TargetKind::squares);
  EXPECT_EQ(squares.columns, 7);
  EXPECT_EQ(squares.rows, 5);
  EXPECT_DOUBLE_EQ(squares.size, 0.02);
  EXPECT_DOUBLE_EQ(squares.gap, 0.02);
  EXPECT_DOUBLE_EQ(parse_target("squares:7x5:0.02:1.5cm").gap, 0.015);
  EXPECT_DOUBLE_EQ(parse_target("chessboard:9x6:0.025m").size, 0.025);
  const Target charuco = parse_target("charuco:10x7:30mm:22.5mm:5X5_100");
  EXPECT_DOUBLE_EQ(charuco.marker, 0.0225);
  EXPECT_EQ(charuco.dictionary, "5X5_100");
  EXPECT_DOUBLE_EQ(parse_target("aprilgrid:6x6:88mm:0.3").gap, 0.3 * 0.088);
}

TEST(Target, WrongTextsSayWhatIsWrong) {
  const auto error = [](const std::string& text) {
    try {
      parse_target(text);
    } catch (const UsageError& e) {
      return std::string(e.what());
    }
    return std::string();
  };
  EXPECT_THAT(error("circles:4x5:20mm"), AllOf(HasSubstr("'circles'"), HasSubstr("chessboard:9x6:25mm")));
  EXPECT_THAT(error("chessboard:9x6"), HasSubstr("number of parts"));
  EXPECT_THAT(error("chessboard:9:25mm"), HasSubstr("COLUMNSxROWS"));
  EXPECT_THAT(error("chessboard:9x2:25mm"), HasSubstr("'2'"));
  EXPECT_THAT(error("chessboard:9x6:25in"), HasSubstr("no length"));
  EXPECT_THAT(error("chessboard:9x6:25"), HasSubstr("metres"));  // forgotten unit
  EXPECT_THAT(error("chessboard:9x6:-1mm"), HasSubstr("cannot be"));
  EXPECT_THAT(error("charuco:10x7:30mm:30mm"), HasSubstr("not smaller"));
  EXPECT_THAT(error("aprilgrid:6x6:88mm:26mm"), HasSubstr("spacing"));
}

TEST(Target, CornersLieWhereTheSheetHasThem) {
  const auto squares = target_points(parse_target("squares:7x5:20mm"));
  ASSERT_EQ(squares.size(), 140u);  // thesis 2.3
  EXPECT_TRUE(squares[4].isApprox(Eigen::Vector3d(0.04, 0, 0)));
  EXPECT_TRUE(squares[2].isApprox(Eigen::Vector3d(0.02, 0.02, 0)));
  EXPECT_TRUE(squares[4 * 7 + 3].isApprox(Eigen::Vector3d(0, 0.06, 0)));
  EXPECT_EQ(target_points(parse_target("charuco:10x7:30mm:20mm")).size(), 54u);
  const auto tags = target_points(parse_target("aprilgrid:3x2:100mm:0.5"));
  EXPECT_TRUE(tags[0].isApprox(Eigen::Vector3d(0, 0.15, 0)));         // tag 0 is the lower left one
  EXPECT_TRUE(tags[4 * 3 + 1].isApprox(Eigen::Vector3d(0.1, 0, 0)));  // tag 3 stands above it
}

TEST(Target, SymmetriesBringCornersOntoCorners) {
  EXPECT_EQ(target_symmetries(parse_target("squares:7x5:20mm")).size(), 2u);
  EXPECT_EQ(target_symmetries(parse_target("squares:5x5:20mm")).size(), 4u);
  EXPECT_EQ(target_symmetries(parse_target("charuco:10x7:30mm:20mm")).size(), 1u);
  const auto turned = target_symmetries(parse_target("chessboard:9x6:25mm")).at(1);
  for (size_t i = 0; i < turned.size(); ++i) EXPECT_EQ(turned[i], 53 - static_cast<int>(i));
  // The first corner of the first square is the third of the last one.
  EXPECT_EQ(target_symmetries(parse_target("squares:7x5:20mm")).at(1)[0], 138);
}

}  // namespace
}  // namespace iris::calibrate
