// Uses the package as somebody in the editor does: through its components and its menu. The first argument says what.

using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Linq;
using System.Reflection;
using System.Text;
using System.Threading;
using Clothfit;
using Clothfit.Editing;
using UnityEditor;
using UnityEngine;
using Debug = UnityEngine.Debug;

static class Program
{
    static int Main(string[] arguments)
    {
        Console.OutputEncoding = new UTF8Encoding(false);
        string[] rest = arguments.Skip(1).ToArray();
        switch (arguments[0])
        {
            case "number": Numbers(); break;
            case "json": Json(); break;
            case "copy": SceneFile.Read(rest[0]).Write(rest[1]); break;
            case "scene": SceneBuilder.Build(Scenes.Named(rest[0])).Write(rest[1]); break;
            case "import": Import(rest[0], rest[1], rest[2]); break;
            case "rules": Rules(); break;
            case "menus": Menus(); break;
            case "tests": Tests(rest[0]); break;
            case "quote": foreach (string each in rest) Console.WriteLine(Command.AsInWindows(each)); break;
            case "echo": Echo(rest[0], rest.Skip(1)); break;
            case "motion": Motion(rest[0], int.Parse(rest[1]), int.Parse(rest[2])); break;
            case "play": Play(rest[0], rest[1]); break;
            case "subspace": Network(rest[0], rest[1], int.Parse(rest[2])); break;
            case "journey": Journeys.Run(rest[0], rest[1], rest[2], rest[3]); break;
            default: return 2;
        }
        return 0;
    }

    /// <summary>Runs the package's tests as the Test Runner does, and prints their names.</summary>
    static void Tests(string library)
    {
        foreach (Type type in Assembly.LoadFrom(library).GetTypes().Where(each => each.IsPublic))
            foreach (MethodInfo test in type.GetMethods().Where(each => each.GetCustomAttribute<NUnit.Framework.TestAttribute>() != null))
            {
                object made = Activator.CreateInstance(type);
                foreach (MethodInfo first in type.GetMethods().Where(each => each.GetCustomAttribute<NUnit.Framework.SetUpAttribute>() != null))
                    first.Invoke(made, null);
                test.Invoke(made, null);
                Console.WriteLine(test.Name);
            }
    }

    /// <summary>Prints a float32 for each line.</summary>
    static void Numbers()
    {
        string line;
        while ((line = Console.ReadLine()) != null)
            Console.WriteLine(JsonUtility.ToJson(new One { v = BitConverter.ToSingle(BitConverter.GetBytes(uint.Parse(line)), 0) }));
    }

    [Serializable]
    class One
    {
        public float v;
    }

    [Serializable]
    class Strange : One
    {
        public Dictionary<string, int> map = new Dictionary<string, int> { { "a", 1 } };
        public List<List<int>> nested = new List<List<int>> { new List<int> { 1 } };
        public List<One> none = null;
        public One absent = null;
        public string text;
        public int? maybe = 3;
        public Interpolation choice = Interpolation.Hold;
        [SerializeField] bool hidden = true;
        [NonSerialized] public int left = 4;
        public readonly int fixedOne = 5;
        public static int shared = 6;
        int own = hiddenOne;
        const int hiddenOne = 7;

        public int Property
        {
            get { return own + (hidden ? 1 : 0); }
        }
    }

    /// <summary>The rules of serialisation, seen on a class that breaks most of them.</summary>
    static void Json()
    {
        Console.WriteLine(JsonUtility.ToJson(new Strange { text = "a\"\\\n\u0001é" }));
        var found = JsonUtility.FromJson<Strange>("{\"text\":\"b\",\"new\":1,\"none\":[{\"v\":2},{}],\"nested\":[[1]]}");
        Console.WriteLine(JsonUtility.ToJson(found));
        Console.WriteLine(JsonUtility.ToJson(new List<int> { 1 }));
        try
        {
            JsonUtility.FromJson<One>("[1]");
        }
        catch (ArgumentException error)
        {
            Console.WriteLine(error.Message);
        }
    }

    static void Import(string name, string fitted, string again)
    {
        ClothfitScene settings = Scenes.Named(name);
        SceneImport.Apply(SceneFile.Read(fitted), settings);
        SceneBuilder.Build(settings).Write(again);
    }

    /// <summary>Prints the fields of the package that Unity would not serialise, and those of components without tooltip.</summary>
    static void Rules()
    {
        Type[] types = typeof(SceneData).Assembly.GetTypes();
        foreach (Type type in types.Where(each => typeof(MonoBehaviour).IsAssignableFrom(each) || Serialisation.IsClass(each)))
            foreach (FieldInfo field in type.GetFields(BindingFlags.Instance | BindingFlags.Public | BindingFlags.DeclaredOnly))
            {
                if (field.IsInitOnly) continue;
                string name = type.Name + "." + field.Name;
                if (!Serialisation.IsType(field.FieldType)) Console.WriteLine("not serialised: " + name);
                bool shown = typeof(MonoBehaviour).IsAssignableFrom(type) && !field.IsDefined(typeof(HideInInspector), false);
                if (shown && !field.IsDefined(typeof(TooltipAttribute), false)) Console.WriteLine("no tooltip: " + name);
            }
        Console.WriteLine(types.Count(each => typeof(MonoBehaviour).IsAssignableFrom(each) && !each.IsAbstract) + " components");
    }

    static void Menus()
    {
        IEnumerable<MethodInfo> methods = typeof(ClothfitMenu).GetMethods(BindingFlags.Static | BindingFlags.Public);
        foreach (MethodInfo each in methods)
            foreach (MenuItem item in each.GetCustomAttributes(typeof(MenuItem), false))
                if (!item.Validates) Console.WriteLine(item.Path);
    }

    /// <summary>Calls a program with arguments through the package's own runner and prints what it says.</summary>
    static void Echo(string program, IEnumerable<string> arguments)
    {
        using (var run = new CommandRun(new Command(program).Call(arguments, ".")))
        {
            while (run.Ended() == null) Thread.Sleep(5);
            Console.Write(run.Output);
        }
    }

    static void Motion(string path, int frame, int points)
    {
        using (var file = new MotionFile(path))
        {
            var places = new Vector3[points];
            file.Read(frame, 0, places);
            Console.WriteLine(file.Frames + " " + file.Points);
            foreach (Vector3 each in places) Journeys.Print(each);
        }
    }

    /// <summary>Plays a network on a cloth and prints the places of its mesh's vertices, and their normals, in the world.</summary>
    static void Network(string name, string model, int steps)
    {
        ClothfitCloth cloth = Scenes.Named(name).All<ClothfitCloth>().First();
        var player = cloth.gameObject.AddComponent<ClothfitSubspacePlayer>();
        player.model = model;
        for (int t = 0; t < steps; t++)
        {
            player.signals = Console.ReadLine().Split(' ').Select(each => float.Parse(each, CultureInfo.InvariantCulture)).ToArray();
            player.Step();
        }
        Console.WriteLine(player.Error ?? "no error");
        Mesh mesh = cloth.GetComponent<MeshFilter>().sharedMesh;
        foreach (Vector3 each in mesh.vertices) Journeys.Print(cloth.transform.TransformPoint(each));
        foreach (Vector3 each in mesh.normals) Journeys.Print(cloth.transform.TransformDirection(each));
    }

    /// <summary>Plays a motion on the cloths of a scene and prints the places of their meshes' vertices in the world.</summary>
    static void Play(string name, string motion)
    {
        ClothfitScene settings = Scenes.Named(name);
        Players.Attach(settings, motion);
        foreach (ClothfitCloth cloth in settings.All<ClothfitCloth>())
        {
            var player = cloth.GetComponent<ClothfitPlayer>();
            player.Show(7 * settings.timeStep);
            Vector3[] vertices = cloth.GetComponent<MeshFilter>().sharedMesh.vertices;
            foreach (Vector3 each in vertices) Journeys.Print(cloth.transform.TransformPoint(each));
            string error = player.Error ?? "no error";
            player.Close();
            Console.WriteLine(SceneBuilder.Object(cloth).vertPos.Count + " " + error);
        }
    }
}
