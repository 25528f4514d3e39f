// Scenes that are put together from components, as in the editor.

using System;
using System.Collections.Generic;
using Clothfit;
using UnityEngine;

static class Scenes
{
    public static ClothfitScene Named(string name)
    {
        switch (name)
        {
            case "side": return Side();
            case "trial": return Trial();
            case "long": return Long();
            case "everything": return Everything();
            case "seam": return Seam();
            case "gusts": return Gusts();
            case "empty": return Add<ClothfitScene>(null, "empty");
            default: throw new ArgumentException(name);
        }
    }

    static T Add<T>(ClothfitScene root, string name) where T : Component
    {
        T made = new GameObject(name).AddComponent<T>();
        if (root != null) made.transform.SetParent(root.transform, false);
        return made;
    }

    static ClothfitCloth Cloth(ClothfitScene root, string name, int divisions, float width, float length)
    {
        var plane = Add<ClothfitPlane>(root, name);
        plane.divisions = divisions;
        plane.width = width;
        plane.length = length;
        plane.Make();
        return plane.gameObject.AddComponent<ClothfitCloth>();
    }

    static ClothfitFixer Fixer(ClothfitScene root, Vector3 at, Vector3 size)
    {
        var fixer = Add<ClothfitFixer>(root, "fixer");
        fixer.transform.localPosition = at;
        fixer.transform.localScale = size;
        return fixer;
    }

    static TimedKeys Keys(Interpolation interpolation, params float[] numbers)
    {
        var keys = new TimedKeys { interpolation = interpolation };
        for (int k = 0; k < numbers.Length; k += 4)
            keys.keys.Add(new TimedKey { time = numbers[k], value = new Vector3(numbers[k + 1], numbers[k + 2], numbers[k + 3]) });
        return keys;
    }

    /// <summary>The settings of the editor's own scene of this name.</summary>
    static ClothfitScene Side()
    {
        var root = Add<ClothfitScene>(null, "side");
        Cloth(root, "first", 10, 7f, 7f);
        ClothfitCloth second = Cloth(root, "second", 10, 7f, 7f);
        second.transform.localPosition = new Vector3(0f, -0.001f, 0f);
        second.fitStiffness = FittedMany.No;
        Fixer(root, new Vector3(0f, 0f, 3.5f), new Vector3(8f, 1f, 0.2f));
        return root;
    }

    /// <summary>A small cloth, of which stiffnesses, damping and wind are fitted.</summary>
    static ClothfitScene Trial()
    {
        var root = Add<ClothfitScene>(null, "Vorhang \u00fc \u7a97");
        root.frames = 20;
        root.fitWind = true;
        root.transform.localPosition = new Vector3(0.1f, 1.7f, -0.3f);
        ClothfitCloth cloth = Cloth(root, "cloth", 3, 1f, 0.8f);
        cloth.transform.localRotation = Quaternion.Euler(20f, 30f, 0f);
        cloth.stiffness = 20f;
        cloth.fitDamping = true;
        Cloth(root, "beside", 2, 0.5f, 0.5f).fitStiffness = FittedMany.No;
        Fixer(root, new Vector3(-0.4f, 0f, 0.2f), new Vector3(0.3f, 1f, 1f));
        Add<ClothfitWind>(root, "wind").velocity = new Vector3(2f, 0f, 1f);
        return root;
    }

    /// <summary>The same with a fit that does not come to an end by itself.</summary>
    static ClothfitScene Long()
    {
        ClothfitScene root = Trial();
        root.frames = 60;
        root.options = "--start 1 --rmse 0 --max-evaluations 1000000 --method l-bfgs-b --prior none --quiet";
        foreach (ClothfitCloth cloth in root.All<ClothfitCloth>()) cloth.fitMass = cloth.fitStiffness = FittedMany.Each;
        return root;
    }

    /// <summary>A cloth in a wind that changes, without anything else.</summary>
    static ClothfitScene Gusts()
    {
        var root = Add<ClothfitScene>(null, "gusts");
        root.transform.localPosition = new Vector3(0.5f, 1f, 0f);
        Cloth(root, "cloth", 3, 1f, 1f).transform.localRotation = Quaternion.Euler(0f, 40f, 90f);
        Fixer(root, new Vector3(0f, 0.5f, 0f), new Vector3(2f, 0.1f, 2f));
        Add<ClothfitWind>(root, "wind").keys = Keys(Interpolation.Linear, 0f, 1f, 0f, 0f, 0.3f, -2f, 1f, 3f, 0.6f, 0f, 0f, 2f);
        return root;
    }

    /// <summary>All that the package can write.</summary>
    static ClothfitScene Everything()
    {
        var root = Add<ClothfitScene>(null, "everything \"quoted\"");
        root.integrator = Integrator.Bdf2;
        root.frames = 12;
        root.ownGravity = root.fitGravity = root.fitWind = root.fitWindKeys = root.fitObstacleOffset = true;
        root.gravity = new Vector3(0f, -9.7f, 0.1f);
        root.gravityKeys = Keys(Interpolation.Hold, 0f, 0f, 0f, 0f, 0.1f, 0f, 1f, 0f);
        root.selfContact = new Contact { own = true, thickness = 0.01f, stiffness = 800f, friction = 0.2f };
        root.obstacleOffset = new Vector3(0.01f, 0f, 0f);
        root.fitFriction = Fitted.One;
        root.fitContact = Fitted.Each;
        root.bounds.Add(new FitBounds { kind = FitKind.Wind, low = -20f, high = 20f });
        ClothfitCloth cloth = Cloth(root, "cloth", 4, 1f, 1f);
        cloth.fitMass = FittedMany.One;
        cloth.fitStiffness = FittedMany.Families;
        cloth.fitRestLength = FittedMany.Factor;
        cloth.fitVelocity = Fitted.One;
        cloth.fitDamping = cloth.fitDrag = cloth.fitPaths = cloth.fitPinOffset = true;
        cloth.velocity = new Vector3(0f, 0.5f, 0f);
        cloth.warp = new Vector3(1f, 0f, 0f);
        cloth.bounds.Add(new FitBounds { kind = FitKind.Stiffness, low = 1f, high = 500f });
        cloth.bounds.Add(new FitBounds { kind = FitKind.Path, low = -1f, high = 1f });
        ClothfitFixer moving = Fixer(root, new Vector3(-0.5f, 0f, 0f), new Vector3(0.1f, 0.1f, 2f));
        moving.positionKeys = Keys(Interpolation.Smooth, 0f, 0f, 0f, 0f, 0.2f, 0f, 0.1f, 0f);
        moving.rotationKeys = Keys(Interpolation.Linear, 0f, 0f, 0f, 0f, 0.2f, 10f, 0f, 0f);
        Fixer(root, new Vector3(0.5f, 0f, 0.5f), new Vector3(0.1f, 0.1f, 0.1f));
        ClothfitWind wind = Add<ClothfitWind>(root, "wind");
        wind.velocity = new Vector3(1f, 0f, 0f);
        wind.keys = Keys(Interpolation.Linear, 0f, 0f, 0f, 0f, 0.1f, 2f, 0f, 0f);
        Add<ClothfitSphere>(root, "sphere");
        Add<ClothfitCapsule>(root, "capsule");
        Add<ClothfitBox>(root, "box");
        Add<ClothfitGround>(root, "ground");
        foreach (ClothfitObstacle each in root.All<ClothfitObstacle>())
        {
            each.transform.localPosition = new Vector3(0.2f * each.Type, -1f, 0f);
            each.transform.localRotation = Quaternion.Euler(10f, 20f, 5f);
            each.transform.localScale = new Vector3(0.3f, 0.3f, 0.3f);
            each.contact = new Contact { own = true, thickness = 0.005f, stiffness = 900f, friction = 0.3f };
            each.positionKeys = Keys(Interpolation.Linear, 0f, 0f, 0f, 0f, 0.3f, 0.1f, 0f, 0f);
            if (each.Type == Obstacles.Box) each.scaleKeys = Keys(Interpolation.Linear, 0f, 1f, 1f, 1f, 0.3f, 2f, 1f, 1f);
        }
        return root;
    }

    /// <summary>A mesh of two squares with a seam: it has two vertices in two of its places, one of them at -0, and one too many.</summary>
    static ClothfitScene Seam()
    {
        var root = Add<ClothfitScene>(null, "seam");
        var cloth = Add<ClothfitCloth>(root, "cloth");
        var mesh = new Mesh();
        var below = new Vector3(-0f, -0f, -0f);
        mesh.vertices = new[] { At(-1, 0), At(-1, 1), At(0, 0), At(0, 1), below, At(0, 1), At(1, 0), At(1, 1), At(5, 5) };
        mesh.triangles = new[] { 0, 1, 2, 1, 3, 2, 4, 5, 6, 5, 7, 6 };
        cloth.GetComponent<MeshFilter>().sharedMesh = mesh;
        return root;
    }

    static Vector3 At(float x, float z)
    {
        return new Vector3(x, 0f, z);
    }
}
