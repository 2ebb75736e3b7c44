import java.io.BufferedOutputStream;
import java.io.DataOutputStream;
import java.io.File;
import java.io.FileOutputStream;
import java.nio.file.Files;
import java.nio.file.Path;
import java.util.ArrayList;
import java.util.LinkedHashMap;
import java.util.List;
import java.util.Map;
import no.ntnu.ihb.fmi4j.importer.fmi2.CoSimulationSlave;
import no.ntnu.ihb.fmi4j.importer.fmi2.Fmu;

/**
 * Couples FMUs with FMI4j in a fixed-step loop, as its users write it: one call for each instance and purpose.
 *
 * <p>Arguments: a case and the file for the result. The case has one item a line, its fields separated by tabs:
 * {@code steps N H}, {@code fmu INSTANCE FILE}, {@code start INSTANCE VARIABLE VALUE},
 * {@code connect INSTANCE VARIABLE INSTANCE VARIABLE} (in order of exchange), {@code record INSTANCE VARIABLE},
 * {@code path INSTANCE VARIABLE}. The result is a sequence of big-endian doubles: seconds of the loop and of all,
 * then for each communication point the values of the path.
 */
public final class Fmi4jLoop {

    /** Outputs of one instance that feed inputs of another. */
    private static final class Transfer {
        final CoSimulationSlave source;
        final CoSimulationSlave target;
        final long[] outputs;
        final long[] inputs;
        final double[] values;

        Transfer(CoSimulationSlave source, CoSimulationSlave target, List<String> outputs, List<String> inputs) {
            this.source = source;
            this.target = target;
            this.outputs = references(source, outputs);
            this.inputs = references(target, inputs);
            this.values = new double[outputs.size()];
        }

        boolean run() {
            return source.readReal(outputs, values).isOK() && target.writeReal(inputs, values).isOK();
        }
    }

    public static void main(String[] arguments) throws Exception {
        List<String[]> items = new ArrayList<>();
        for (String line : Files.readAllLines(Path.of(arguments[0]))) {
            items.add(line.split("\t"));
        }
        simulate(items, null); // the first run is the compiler's
        simulate(items, new File(arguments[1]));
    }

    private static void simulate(List<String[]> items, File result) throws Exception {
        long began = System.nanoTime();
        Map<String, Fmu> fmus = new LinkedHashMap<>();
        Map<String, CoSimulationSlave> slaves = new LinkedHashMap<>();
        Map<String, List<String>> recorded = new LinkedHashMap<>();
        Map<List<String>, List<List<String>>> connected = new LinkedHashMap<>();
        List<String[]> path = new ArrayList<>();
        int steps = 0;
        double stepSize = 0.0;
        for (String[] item : items) {
            switch (item[0]) {
                case "steps" -> {
                    steps = Integer.parseInt(item[1]);
                    stepSize = Double.parseDouble(item[2]);
                }
                case "fmu" -> {
                    Fmu fmu = Fmu.from(new File(item[2]));
                    CoSimulationSlave slave = fmu.asCoSimulationFmu().newInstance(item[1]);
                    check(slave.setupExperiment(0.0, 0.0, 0.0));
                    fmus.put(item[1], fmu);
                    slaves.put(item[1], slave);
                }
                case "start" -> {
                    CoSimulationSlave slave = slaves.get(item[1]);
                    double[] value = {Double.parseDouble(item[3])};
                    check(slave.writeReal(references(slave, List.of(item[2])), value).isOK());
                }
                case "connect" -> {
                    List<List<String>> pair = connected.computeIfAbsent(
                        List.of(item[1], item[3]), key -> List.of(new ArrayList<>(), new ArrayList<>()));
                    pair.get(0).add(item[2]);
                    pair.get(1).add(item[4]);
                }
                case "record" -> recorded.computeIfAbsent(item[1], key -> new ArrayList<>()).add(item[2]);
                case "path" -> path.add(item);
                default -> throw new IllegalArgumentException(item[0]);
            }
        }

        Transfer[] transfers = connected.entrySet().stream()
            .map(e -> new Transfer(slaves.get(e.getKey().get(0)), slaves.get(e.getKey().get(1)),
                e.getValue().get(0), e.getValue().get(1)))
            .toArray(Transfer[]::new);
        CoSimulationSlave[] instances = slaves.values().toArray(CoSimulationSlave[]::new);
        List<String> sources = new ArrayList<>(recorded.keySet());
        CoSimulationSlave[] read = sources.stream().map(slaves::get).toArray(CoSimulationSlave[]::new);
        long[][] references = new long[read.length][];
        double[][][] records = new double[read.length][steps + 1][];
        for (int k = 0; k < read.length; k++) {
            references[k] = references(read[k], recorded.get(sources.get(k)));
            for (int i = 0; i <= steps; i++) {
                records[k][i] = new double[references[k].length];
            }
        }
        for (CoSimulationSlave slave : instances) {
            check(slave.enterInitializationMode());
        }
        for (Transfer transfer : transfers) {
            check(transfer.run());
        }
        for (CoSimulationSlave slave : instances) {
            check(slave.exitInitializationMode());
        }

        long loopBegan = System.nanoTime();
        boolean ok = true;
        for (int i = 0; i <= steps; i++) {
            if (i > 0) {
                for (CoSimulationSlave slave : instances) {
                    ok &= slave.doStep((i - 1) * stepSize, stepSize);
                }
            }
            for (Transfer transfer : transfers) {
                ok &= transfer.run();
            }
            for (int k = 0; k < read.length; k++) {
                ok &= read[k].readReal(references[k], records[k][i]).isOK();
            }
        }
        long ended = System.nanoTime();
        check(ok);
        for (Fmu fmu : fmus.values()) {
            fmu.close();
        }
        if (result != null) {
            try (DataOutputStream out = new DataOutputStream(new BufferedOutputStream(new FileOutputStream(result)))) {
                out.writeDouble((ended - loopBegan) * 1e-9);
                out.writeDouble((System.nanoTime() - began) * 1e-9);
                for (int i = 0; i <= steps; i++) {
                    for (String[] item : path) {
                        out.writeDouble(records[sources.indexOf(item[1])][i][recorded.get(item[1]).indexOf(item[2])]);
                    }
                }
            }
        }
    }

    private static long[] references(CoSimulationSlave slave, List<String> names) {
        return slave.getModelVariables().getValueReferences(names.toArray(String[]::new));
    }

    private static void check(boolean ok) {
        if (!ok) {
            throw new IllegalStateException("an FMU did not return OK");
        }
    }
}
