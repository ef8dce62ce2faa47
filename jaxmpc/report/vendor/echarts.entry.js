export { init, use } from "echarts/core";
import { use } from "echarts/core";
import { BarChart, HeatmapChart, LineChart, ScatterChart } from "echarts/charts";
import {
  DataZoomInsideComponent, GridComponent, LegendComponent, MarkLineComponent,
  TitleComponent, TooltipComponent, VisualMapContinuousComponent,
} from "echarts/components";
import { CanvasRenderer } from "echarts/renderers";
use([
  BarChart, HeatmapChart, LineChart, ScatterChart, DataZoomInsideComponent, GridComponent,
  LegendComponent, MarkLineComponent, TitleComponent, TooltipComponent,
  VisualMapContinuousComponent, CanvasRenderer,
]);
